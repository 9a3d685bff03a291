"""One suture as driven by an arm: dense joint paths, including the way in and the way out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik_unbounded
from trocar.errors import TrocarError
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning.joints import INSERTION, LIMIT_TOLERANCE, ROLL
from trocar.tasks.suture.planning.primitive import driven_steps, exit_turn_rad, needle_poses, tip_poses, turned_to
from trocar.tasks.suture.planning.setup import DIRECTIONS, SutureSetup

SPACING_M, SPACING_RAD = 0.25e-3, math.radians(1.0)
"""Spacing of the places along a path."""
BEYOND_RAD = math.radians(10.0)
"""Open jaws go back along the wire this far beyond where they close, and then forward again, so that the cables have
taken up their play in the direction in which the jaws push."""
ROOM_RAD = math.radians(15.0)
"""Above the tissue, where the path is free to end early, joints keep this margin: compensated commands may need it."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Suture:
    """One suture to drive.

    Attributes:
        setup: the geometry.
        theta_rad: its position on the circle.
        direction: one of ``DIRECTIONS``.
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
        """Return the primitive's poses (2, k) at theta = 0, moved to this suture's position and direction: (k,)."""
        return turned_to(T_circle, [self.theta_rad])[DIRECTIONS.index(self.direction), 0]

    def needle_tip_m(self, advance_m: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the needle's tip (k, 3) in the circle's frame; arguments as ``needle_poses``."""
        T_circle_needle = self.turned(needle_poses(self.setup, advance_m, turn_rad))
        return T_circle_needle.apply([0.0, -self.setup.needle.radius_m, 0.0])

    @property
    def needle_path_m(self) -> NDArray[np.float64]:
        """Return the path (k, 3) of the needle's tip in the circle's frame while the jaws drive the needle."""
        insertion = self.setup.insertion
        advance = np.linspace(0.0, insertion.straight_m, 1 + math.ceil(insertion.straight_m / SPACING_M))
        last = insertion.rotation_rad + insertion.pushes * insertion.regrasp_rad
        turn = np.linspace(0.0, last, 1 + math.ceil(last / SPACING_RAD))[1:]
        return self.needle_tip_m(
            np.append(advance, np.full(len(turn), insertion.straight_m)), np.append(np.zeros(len(advance)), turn)
        )

    @property
    def entry_m(self) -> NDArray[np.float64]:
        """Return the point (3,) where the needle enters the surface, in the circle's frame."""
        return self.needle_tip_m(np.zeros(1), np.zeros(1))[0]

    @property
    def exit_m(self) -> NDArray[np.float64] | None:
        """Return the point (3,) where the needle comes out again, in the circle's frame; None if it never does."""
        insertion, turn = self.setup.insertion, exit_turn_rad(self.setup)
        if not turn <= insertion.rotation_rad + insertion.pushes * insertion.regrasp_rad:
            return None
        return self.needle_tip_m(np.array([insertion.straight_m]), np.array([turn]))[0]


def ranges(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the joints' limits (6,), (6,), with the insertion restricted so that the wrist keeps its safe depth."""
    lower, upper = arm.lower.copy(), arm.upper.copy()
    sign = -arm.wrist_sign
    nearest = sign * arm.safe_depth_m - arm.offsets[INSERTION]
    ends = (lower, np.maximum) if sign > 0 else (upper, np.minimum)
    ends[0][INSERTION] = ends[1](ends[0][INSERTION], nearest)
    return lower, upper


@dataclass(frozen=True, eq=False)
class Segment:
    """A segment of the path, between two actions of the jaws.

    Attributes:
        name: lower, approach, the name of a step of the primitive, withdraw, or rise.
        q: (k, 6) joints; NaN where the arm has no solution. The roll is continuous over all segments.
        length_m: length of the path of the jaws.
        beyond: number of its last places that are beyond its end: the jaws go there, and back to the end.
    """

    name: str
    q: NDArray[np.float64]
    length_m: float
    beyond: int = 0

    @property
    def regrasps(self) -> bool:
        """Return whether the open jaws move back along the wire."""
        return self.name.startswith("regrasp")

    @property
    def back(self) -> Segment:
        """Return the path from beyond the end back to it."""
        q = self.q[::-1][: self.beyond + 1]
        return Segment(self.name, q, self.length_m * self.beyond / max(1, len(self.q) - 1))

    def first_outside(self, arm: ArmModel, room_rad: float = 0.0) -> tuple[int, int] | None:
        """Return (place, joint) where the path first leaves a joint's range, or None; joint -1: no solution there.

        Args:
            arm: the arm.
            room_rad: margin that rotary joints keep to their limits.
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
) -> tuple[Segment, ...]:
    """Return the segments of one suture: ``lower``, ``approach``, the primitive's steps, ``withdraw``, ``rise``.

    The roll has the same winding as in the plan, which depends on the primitive alone. The ways in and out are cut
    short where they would leave the joints' ranges; the primitive is not.

    Args:
        suture: the suture; the base in its setup is the registered one.
        lift_m: height from which the arm is lowered at the start, and to which it rises at the end.
        approach_m: length of the approach along the needle's initial direction.
        withdraw_m: how far the open jaws back off along their own axis at the end.
    """
    setup = suture.setup
    into = suture.turned(tip_poses(setup, _spread(-approach_m, 0.0, SPACING_M), 0.0))
    above = _shifted(into[0], UP, lift_m, 0.0)
    names, lengths = ["lower", "approach"], [lift_m, approach_m]
    poses, beyond = [above.matrix, into.matrix], [0, 0]
    for step in driven_steps(setup):
        count = max(len(_spread(*step.advance_m, SPACING_M)), len(_spread(*step.jaws_rad, SPACING_RAD)))
        advance, jaws = np.linspace(*step.advance_m, count), np.linspace(*step.jaws_rad, count)
        further = np.zeros(0) if step.holds else _further(jaws)
        jaws, advance = np.append(jaws, further), np.append(advance, np.full(len(further), advance[-1]))
        names.append(step.name)
        lengths.append(float(abs(advance[-1] - advance[0]) + setup.needle.radius_m * abs(jaws[-1] - jaws[0])))
        beyond.append(len(further))
        poses.append(suture.turned(tip_poses(setup, advance, jaws)).matrix)
    last = SE3.unchecked(poses[-1][-1])
    back = _shifted(last, last.matrix[:3, 2], 0.0, withdraw_m)
    out = _shifted(back[-1], UP, 0.0, lift_m)
    names += ["withdraw", "rise"]
    lengths += [withdraw_m, lift_m]
    beyond += [0, 0]
    poses += [back.matrix, out.matrix]
    ends = np.cumsum([len(matrices) for matrices in poses])
    q = ik_unbounded(setup.arm, setup.T_base_circle @ SE3.unchecked(np.concatenate(poses)))
    q[:, ROLL] = _unwound(q[:, ROLL], slice(int(ends[1]), int(ends[-3])), setup.arm.middle_floats[ROLL])
    found = [Segment(*parts) for parts in zip(names, np.split(q, ends[:-1]), lengths, beyond, strict=True)]
    approach, lower = cut_short(found[1::-1], setup.arm, -1)
    return (lower, approach, *found[2:-2], *cut_short(found[-2:], setup.arm))


def way_out(
    setup: SutureSetup, q: NDArray[np.float64], lift_m: float = 0.025, withdraw_m: float = 0.010
) -> tuple[Segment, ...]:
    """Return ``withdraw`` and ``rise`` from any joints (6,), cut short where they would leave the joints' ranges."""
    here = setup.T_base_circle.inverse() @ fk(setup.arm, q)
    back = _shifted(here, here.matrix[:3, 2], 0.0, withdraw_m)
    parts = {"withdraw": (back, withdraw_m), "rise": (_shifted(back[-1], UP, 0.0, lift_m), lift_m)}
    found = [
        Segment(name, ik_unbounded(setup.arm, setup.T_base_circle @ T, near=np.broadcast_to(q, (len(T.matrix), 6))), m)
        for name, (T, m) in parts.items()
    ]
    return tuple(cut_short(found, setup.arm))


def cut_short(segments: Sequence[Segment], arm: ArmModel, order: int = 1) -> list[Segment]:
    """Return segments up to the first place out of range; those beyond it are left empty.

    Args:
        segments: one after the other.
        arm: whose joints they are.
        order: 1 to count from their starts, -1 from their ends.
    """
    kept: list[Segment] = []
    broken = False
    for segment in segments:
        room = ROOM_RAD if segment.name in ("lower", "rise") else 0.0
        outside = (0, 0) if broken else replace(segment, q=segment.q[::order]).first_outside(arm, room)
        broken = outside is not None
        if outside is not None:
            q = segment.q[::order][: outside[0]][::order]
            segment = replace(segment, q=q, length_m=segment.length_m * len(q) / len(segment.q))  # noqa: PLW2901
        kept.append(segment)
    return kept


def _further(jaws_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the turns beyond the end of a backward movement, none before the primitive's first; may be empty."""
    end, step = jaws_rad[-1], jaws_rad[-1] - jaws_rad[-2]
    most = min(BEYOND_RAD, max(end, 0.0))
    return end + step * np.arange(1, 1 + math.floor(most / abs(step) + 1e-9)) if step else np.zeros(0)


def _spread(start: float, end: float, spacing: float) -> NDArray[np.float64]:
    """Return two or more evenly spaced values from start to end, at most ``spacing`` apart."""
    return np.linspace(start, end, 2 + math.floor(abs(end - start) / spacing))


def _shifted(T: SE3, along: NDArray[np.float64], start_m: float, end_m: float) -> SE3:
    """Return a pose shifted along a direction (3,), from one distance to another: (k,)."""
    offsets = _spread(start_m, end_m, 4 * SPACING_M)[:, None] * along
    return SE3.from_parts(T.rotation, T.translation_m + offsets)


def _unwound(roll: NDArray[np.float64], primitive: slice, middle: float) -> NDArray[np.float64]:
    """Return roll (k,) without jumps, in the winding that keeps the primitive nearest to the middle of the range."""
    roll = np.unwrap(roll)
    center = (roll[primitive].max() + roll[primitive].min()) / 2
    return roll - TURN * np.rint((center - middle) / TURN)
