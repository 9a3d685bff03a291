"""One suture as an arm drives it: segments of dense joint waypoints, including the way in and the way out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik_unbounded
from trocar.geometry import SE3
from trocar.tasks.suture.planning.primitive import (
    INSERTION,
    LIMIT_TOLERANCE,
    ROLL,
    SPACING_M,
    SPACING_RAD,
    Suture,
    driven_steps,
    tip_poses,
    unwound,
)
from trocar.tasks.suture.planning.setup import SutureSetup

BEYOND_RAD = math.radians(10.0)
"""Open jaws go back along the wire this far beyond where they close, and then forward again, so that the cables have
taken up their play in the direction in which the jaws push."""
ROOM_RAD = math.radians(15.0)
"""Above the tissue, where the path is free to end early, joints keep this margin: compensated commands may need it."""
LIFT_M, APPROACH_M, WITHDRAW_M = 0.025, 0.006, 0.010
"""Height from which the arm is lowered and to which it rises; length of the approach along the needle's first
direction; distance by which open jaws back off along their own axis."""
UP = np.array([0.0, 0.0, 1.0])
DRIVING_M_S = 0.004
"""Mean speed of the jaws along the primitive, slow enough for the cables to take up their play before the needle's next
movement."""
FREE_M_S = {"lower": 0.040, "approach": 0.010, "withdraw": 0.020, "rise": 0.040}
"""Mean speeds on the ways in and out."""
BACK_M_S = 0.015
"""Mean speed of open jaws back along the wire to beyond where they close."""
JAW_CLOSED_RAD = -0.17
"""Target of closed jaws: beyond closed, so that the drive presses."""


def minimum_jerk(share_of_time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of a path (k,) that a minimum-jerk motion has done after shares (k,) of its time."""
    tau = share_of_time
    return tau**3 * (10 - 15 * tau + 6 * tau**2)


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
        beyond: number of last waypoints that lie beyond the segment's end: the jaws go there, and back to the end.
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

    @property
    def free_m_s(self) -> float | None:
        """Return the mean speed of the jaws if they do not drive the needle here; None if they do, or are about to."""
        return BACK_M_S if self.beyond else FREE_M_S.get(self.name)

    def first(self, count: int) -> Segment:
        """Return the path along the first ``count`` waypoints."""
        q = self.q[:count]
        return replace(self, q=q, length_m=self.length_m * len(q) / max(1, len(self.q)))

    def first_outside(self, arm: ArmModel, room_rad: float = 0.0) -> tuple[int, int] | None:
        """Return (waypoint, joint) where the path first leaves a joint's range, or None; joint -1: no solution there.

        Rotary joints have to keep ``room_rad`` to their limits.
        """
        lower, upper = ranges(arm)
        room = np.where(arm.turns > 0, room_rad, 0.0)
        outside = np.maximum(lower + room - self.q, self.q - (upper - room))
        bad = np.flatnonzero(~(outside <= LIMIT_TOLERANCE).all(1))
        if not len(bad):
            return None
        first = int(bad[0])
        return first, int(np.argmax(outside[first])) if np.isfinite(outside[first]).all() else -1


def suture_segments(suture: Suture) -> tuple[Segment, ...]:
    """Return the segments of one suture: ``lower``, ``approach``, the primitive's steps, ``withdraw``, ``rise``.

    The base in its setup is the registered one. The roll has the same winding as in the plan, because the primitive
    alone decides it. The ways in and out are cut short where they would leave the joints' ranges; the primitive is not.
    """
    setup = suture.setup
    into = suture.turned(tip_poses(setup, _spread(-APPROACH_M, 0.0, SPACING_M), 0.0))
    paths = [("lower", _shifted(into[0], UP, LIFT_M, 0.0), LIFT_M, 0), ("approach", into, APPROACH_M, 0)]
    for step in driven_steps(setup):
        count = max(len(_spread(*step.advance_m, SPACING_M)), len(_spread(*step.jaws_rad, SPACING_RAD)))
        advance, jaws = np.linspace(*step.advance_m, count), np.linspace(*step.jaws_rad, count)
        further = np.zeros(0) if step.holds else _further(jaws)
        jaws, advance = np.append(jaws, further), np.append(advance, np.full(len(further), advance[-1]))
        length_m = float(abs(advance[-1] - advance[0]) + setup.needle.radius_m * abs(jaws[-1] - jaws[0]))
        paths.append((step.name, suture.turned(tip_poses(setup, advance, jaws)), length_m, len(further)))
    paths += [(*path, 0) for path in _retreat_paths(paths[-1][1][-1])]
    names, poses, lengths, beyond = zip(*paths, strict=True)
    ends = np.cumsum([len(T.matrix) for T in poses])
    q = ik_unbounded(setup.arm, setup.T_base_circle @ SE3.unchecked(np.concatenate([T.matrix for T in poses])))
    q[:, ROLL] = unwound(q[:, ROLL], setup.arm.middle_floats[ROLL], slice(int(ends[1]), int(ends[-3])))
    found = [Segment(*parts) for parts in zip(names, np.split(q, ends[:-1]), lengths, beyond, strict=True)]
    approach, lower = cut_short(found[1::-1], setup.arm, -1)
    return (lower, approach, *found[2:-2], *cut_short(found[-2:], setup.arm))


def retreat(setup: SutureSetup, q: NDArray[np.float64]) -> tuple[Segment, ...]:
    """Return ``withdraw`` and ``rise`` from any joints (6,), cut short where they would leave the joints' ranges."""
    here = setup.T_base_circle.inverse() @ fk(setup.arm, q)
    found = [
        Segment(name, ik_unbounded(setup.arm, setup.T_base_circle @ T, near=np.broadcast_to(q, (len(T.matrix), 6))), m)
        for name, T, m in _retreat_paths(here)
    ]
    return tuple(cut_short(found, setup.arm))


def cut_short(segments: Sequence[Segment], arm: ArmModel, order: int = 1) -> list[Segment]:
    """Return successive segments up to the first waypoint out of range; segments after it are left empty.

    ``order`` is 1 to count waypoints from the segments' starts, -1 to count from their ends.
    """
    kept: list[Segment] = []
    broken = False
    for segment in segments:
        way = replace(segment, q=segment.q[::order])
        outside = (0, 0) if broken else way.first_outside(arm, ROOM_RAD if way.name in ("lower", "rise") else 0.0)
        if outside is not None:
            broken, way = True, way.first(outside[0])
        kept.append(replace(way, q=way.q[::order]))
    return kept


def _retreat_paths(T_circle_tip: SE3) -> list[tuple[str, SE3, float]]:
    """Return (name, poses in the circle's frame, length) of the way out: along the jaws' own axis, then up."""
    back = _shifted(T_circle_tip, T_circle_tip.matrix[:3, 2], 0.0, WITHDRAW_M)
    return [("withdraw", back, WITHDRAW_M), ("rise", _shifted(back[-1], UP, 0.0, LIFT_M), LIFT_M)]


def _further(jaws_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the jaws' rotations beyond the end of a backward movement, but none below 0; may be empty."""
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
