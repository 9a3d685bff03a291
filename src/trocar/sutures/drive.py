"""One suture as an arm drives it: dense paths of its joints, with a way in and a way out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik_unbounded
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.sutures.joints import LIMIT_TOLERANCE
from trocar.sutures.primitive import exit_turn_rad, needle_poses, steps, tip_poses, turned_to
from trocar.sutures.setup import DIRECTIONS, SutureSetup

INSERTION, ROLL = 2, 3
SPACING_M, SPACING_RAD = 0.25e-3, math.radians(1.0)
"""Between two places of a path."""
ROOM_RAD = math.radians(15.0)
"""High over the tissue, where any other way will do, joints stay this far inside: cables may ask for as much more."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Suture:
    """What is to be done.

    Attributes:
        setup: the geometry.
        theta_rad: where on the circle.
        direction: of ``DIRECTIONS``.
    """

    setup: SutureSetup
    theta_rad: float
    direction: int

    def __post_init__(self) -> None:
        if self.direction not in DIRECTIONS:
            raise TrocarError(f"the direction of a suture is {self.direction!r}; give 1 (clockwise) or -1")
        if not math.isfinite(self.theta_rad):
            raise TrocarError(f"the position of a suture is {self.theta_rad} rad; give a finite angle")

    def turned(self, T_circle: SE3) -> SE3:
        """Return poses (2, k) at theta = 0, as the primitive gives them, at this suture's place: (k,)."""
        return turned_to(T_circle, [self.theta_rad])[DIRECTIONS.index(self.direction), 0]

    def needle_tip_m(self, advance_m: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the needle's tip (k, 3) in the circle's frame; arguments as ``needle_poses``."""
        T_circle_needle = self.turned(needle_poses(self.setup, advance_m, turn_rad))
        return T_circle_needle.apply([0.0, -self.setup.needle.radius_m, 0.0])

    @property
    def needle_path_m(self) -> NDArray[np.float64]:
        """Return the path (k, 3) of the needle's tip in the circle's frame while the jaws drive it."""
        insertion = self.setup.insertion
        advance = np.linspace(0.0, insertion.straight_m, 1 + math.ceil(insertion.straight_m / SPACING_M))
        last = insertion.rotation_rad + insertion.pushes * insertion.regrasp_rad
        turn = np.linspace(0.0, last, 1 + math.ceil(last / SPACING_RAD))[1:]
        return self.needle_tip_m(
            np.append(advance, np.full(len(turn), insertion.straight_m)), np.append(np.zeros(len(advance)), turn)
        )

    @property
    def entry_m(self) -> NDArray[np.float64]:
        """Return where (3,) the needle goes into the surface, in the circle's frame."""
        return self.needle_tip_m(np.zeros(1), np.zeros(1))[0]

    @property
    def exit_m(self) -> NDArray[np.float64] | None:
        """Return where (3,) the needle comes out again, in the circle's frame; None if the primitive ends before."""
        insertion, turn = self.setup.insertion, exit_turn_rad(self.setup)
        if not turn <= insertion.rotation_rad + insertion.pushes * insertion.regrasp_rad:
            return None
        return self.needle_tip_m(np.array([insertion.straight_m]), np.array([turn]))[0]


def ranges(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the joints' limits (6,), (6,), the insertion's cut to where the wrist is at its safe depth or below."""
    lower, upper = arm.lower.copy(), arm.upper.copy()
    sign = -arm.wrist_sign
    nearest = sign * arm.safe_depth_m - arm.offsets[INSERTION]
    ends = (lower, np.maximum) if sign > 0 else (upper, np.minimum)
    ends[0][INSERTION] = ends[1](ends[0][INSERTION], nearest)
    return lower, upper


@dataclass(frozen=True, eq=False)
class Stretch:
    """A piece of the path between two things that the jaws do.

    Attributes:
        name: lower, approach, the primitive's steps, withdraw, rise.
        q: (k, 6) joints; NaN where the arm has no solution. The roll runs on without jumps over all pieces.
        length_m: of the path of the jaws.
    """

    name: str
    q: NDArray[np.float64]
    length_m: float

    @property
    def regrasps(self) -> bool:
        """Return whether the jaws go back along the wire, open."""
        return self.name.startswith("regrasp")

    def first_outside(self, arm: ArmModel, room_rad: float = 0.0) -> tuple[int, int] | None:
        """Return (place, joint) where the path first leaves a joint's range; joint -1 where there is no solution.

        Args:
            arm: whose joints.
            room_rad: how far joints that turn shall stay inside.
        """
        lower, upper = ranges(arm)
        room = np.where(arm.turns > 0, room_rad, 0.0)
        lower, upper = lower + room, upper - room
        for place, q in enumerate(self.q):
            if not np.isfinite(q).all():
                return place, -1
            outside = np.maximum(lower - q, q - upper)
            if outside.max() > LIMIT_TOLERANCE:
                return place, int(np.argmax(outside))
        return None


def drive(
    suture: Suture, lift_m: float = 0.025, approach_m: float = 0.006, withdraw_m: float = 0.010
) -> tuple[Stretch, ...]:
    """Return the pieces of one suture in order: ``lower``, ``approach``, the primitive's steps, ``withdraw``, ``rise``.

    The winding of the roll is that of the plan: it looks at the primitive alone. Way in and way out are cut
    to what the joints' ranges allow; the primitive is not.

    Args:
        suture: which; its setup holds the base as the laboratory knows it.
        lift_m: from above the circle's plane the arm comes this much lower, and rises as much in the end.
        approach_m: last part of the way in, along the needle's first direction.
        withdraw_m: by how much the open jaws go back along themselves in the end.
    """
    setup = suture.setup
    into = suture.turned(tip_poses(setup, _spread(-approach_m, 0.0, SPACING_M), 0.0))
    above = _shifted(into[0], UP, lift_m, 0.0)
    names, lengths = ["lower", "approach"], [lift_m, approach_m]
    poses = [above.matrix, into.matrix]
    for step in steps(setup):
        count = max(len(_spread(*step.advance_m, SPACING_M)), len(_spread(*step.jaws_rad, SPACING_RAD)))
        advance, jaws = np.linspace(*step.advance_m, count), np.linspace(*step.jaws_rad, count)
        names.append(step.name)
        lengths.append(float(abs(advance[-1] - advance[0]) + setup.needle.radius_m * abs(jaws[-1] - jaws[0])))
        poses.append(suture.turned(tip_poses(setup, advance, jaws)).matrix)
    last = SE3(poses[-1][-1])
    back = _shifted(last, last.matrix[:3, 2], 0.0, withdraw_m)
    out = _shifted(back[-1], UP, 0.0, lift_m)
    names += ["withdraw", "rise"]
    lengths += [withdraw_m, lift_m]
    poses += [back.matrix, out.matrix]
    ends = np.cumsum([len(matrices) for matrices in poses])
    q = ik_unbounded(setup.arm, setup.T_base_circle @ SE3(np.concatenate(poses)))
    q[:, ROLL] = _unwound(q[:, ROLL], slice(int(ends[1]), int(ends[-3])), setup.arm.middle_floats[ROLL])
    pieces = np.split(q, ends[:-1])
    found = [Stretch(*parts) for parts in zip(names, pieces, lengths, strict=True)]
    approach, lower = _cut(found[1::-1], setup.arm, -1)
    return (lower, approach, *found[2:-2], *_cut(found[-2:], setup.arm, 1))


def _cut(stretches: Sequence[Stretch], arm: ArmModel, order: int) -> list[Stretch]:
    """Return what the joints allow of stretches, from their starts on (order 1) or from their ends back (-1).

    Behind a place that is out of range nothing is left of the stretches that follow.
    """
    kept: list[Stretch] = []
    broken = False
    for stretch in stretches:
        room = ROOM_RAD if stretch.name in ("lower", "rise") else 0.0
        outside = (0, 0) if broken else replace(stretch, q=stretch.q[::order]).first_outside(arm, room)
        broken = outside is not None
        if outside is not None:
            q = stretch.q[::order][: outside[0]][::order]
            stretch = replace(stretch, q=q, length_m=stretch.length_m * len(q) / len(stretch.q))  # noqa: PLW2901
        kept.append(stretch)
    return kept


def _spread(start: float, end: float, spacing: float) -> NDArray[np.float64]:
    """Return two or more evenly spaced values from start to end."""
    return np.linspace(start, end, 2 + math.floor(abs(end - start) / spacing))


def _shifted(T: SE3, along: NDArray[np.float64], start_m: float, end_m: float) -> SE3:
    """Return a pose at distances along a direction (3,): (k,)."""
    offsets = _spread(start_m, end_m, 4 * SPACING_M)[:, None] * along
    return SE3.from_parts(T.rotation, T.translation_m + offsets)


def _unwound(roll: NDArray[np.float64], primitive: slice, middle: float) -> NDArray[np.float64]:
    """Return roll (k,) without jumps, in the winding that holds the primitive nearest to the middle."""
    roll = np.unwrap(roll)
    center = (roll[primitive].max() + roll[primitive].min()) / 2
    return roll - 2 * np.pi * np.rint((center - middle) / (2 * np.pi))
