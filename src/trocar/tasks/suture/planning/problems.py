"""What is wrong with a plan: sutures out of reach (where, which joint, by how much) or crossing in the tissue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import shown
from trocar.tasks.suture.planning.joints import SutureJoints, suture_joints
from trocar.tasks.suture.planning.primitive import Suture

REMEDY = "move the base, turn the grasp or change the circle's radius"
ARCS_NAMED = 3


@dataclass(frozen=True)
class Arc:
    """An arc of positions that are infeasible in both directions, and the reason.

    Attributes:
        from_rad: first position.
        to_rad: last position, counterclockwise; below ``from_rad`` if the arc contains theta = 0.
        reason: what the better direction would need at the worst position, in words.
    """

    from_rad: float
    to_rad: float
    reason: str


def unreachable_arcs(joints: SutureJoints) -> tuple[Arc, ...]:
    """Return the arcs of these evenly spaced positions at which no direction is feasible, longest first."""
    blocked = np.logical_not(joints.feasible.any(0))
    n = len(joints.thetas_rad)
    if not blocked.any():
        return ()
    excess = relative_excess(joints).max(-1)
    starts = np.flatnonzero(blocked & ~np.roll(blocked, 1)) if not blocked.all() else np.array([0])
    lengths = [n if blocked.all() else int(np.argmin(np.roll(blocked, -start))) for start in starts]
    arcs = []
    for start, length in sorted(zip(starts, lengths, strict=True), key=lambda arc: -arc[1]):
        where = (start + np.arange(length)) % n
        worst = int(where[np.argmax(excess.min(0)[where])])
        reason = _reason(joints, int(np.argmin(excess[:, worst])), worst)
        arcs.append(Arc(float(joints.thetas_rad[where[0]]), float(joints.thetas_rad[where[-1]]), reason))
    return tuple(arcs)


def circle_out_of_reach(joints: SutureJoints) -> str:
    """Return one sentence on all arcs that are out of reach in both directions; empty if there are none."""
    arcs = unreachable_arcs(joints)
    if not arcs:
        return ""
    parts = [f"at {_span(arc, len(joints.thetas_rad))} {arc.reason}" for arc in arcs[:ARCS_NAMED]]
    more = f"; and at {len(arcs) - ARCS_NAMED} more arcs" if len(arcs) > ARCS_NAMED else ""
    return f"circle out of reach: {'; '.join(parts)}{more}; {REMEDY}"


def plan_out_of_reach(sutures: Sequence[Suture]) -> str:
    """Return one sentence on the infeasible sutures of a plan; empty if all are feasible."""
    joints = suture_joints(sutures[0].setup, [suture.theta_rad for suture in sutures])
    parts = [
        f"at {suture} {_reason(joints, suture.row, number)}"
        for number, suture in enumerate(sutures)
        if not joints.feasible[suture.row, number]
    ]
    return f"the plan is out of reach: {'; '.join(parts)}; {REMEDY}" if parts else ""


def relative_excess(joints: SutureJoints) -> NDArray[np.float64]:
    """Return by how much (2, n, 7) each joint leaves its range, as a share of it, and likewise for the safe depth."""
    of_ranges = joints.excess / (joints.arm.upper - joints.arm.lower)
    return np.concatenate([of_ranges, joints.too_shallow_m[..., None] / joints.arm.safe_depth_m], axis=-1)


def _reason(joints: SutureJoints, row: int, position: int) -> str:
    """Return in words what the suture at this position, in this row of ``DIRECTIONS``, would need."""
    arm, q = joints.arm, joints.q[row, position]
    if not np.isfinite(q).all():
        return "no configuration of the arm holds the needle as planned"
    worst = int(np.argmax(relative_excess(joints)[row, position]))
    if worst == len(arm.joints):
        short_m = joints.too_shallow_m[row, position]
        return (
            f"the wrist would be {shown(arm.safe_depth_m - short_m, 'm')} beyond the remote centre, "
            f"{shown(short_m, 'm')} less than the safe depth of {shown(arm.safe_depth_m, 'm', '.0f')}"
        )
    joint, values = arm.joints[worst], q[:, worst]
    over, under = float(values.max()) - joint.upper, joint.lower - float(values.min())
    limit, excess, sign = (joint.upper, over, 1) if over >= under else (joint.lower, under, -1)
    return (
        f"joint '{joint.name}' would reach {joint.shown(limit + sign * excess)}, {joint.shown(excess)} "
        f"beyond its limit of {joint.shown(limit, '.0f')}"
    )


def _span(arc: Arc, positions: int) -> str:
    first, last = math.degrees(arc.from_rad), math.degrees(arc.to_rad)
    if abs((last - first) % 360.0 - (360.0 - 360.0 / positions)) < 1e-6:
        return "all positions"
    return f"{first:.4g} deg" if first == last else f"{first:.4g} to {last:.4g} deg"


Pair = tuple[int, int]


def crossing_sutures(sutures: Sequence[Suture]) -> tuple[Pair, ...]:
    """Return the pairs of sutures whose paths, seen from above, cross or come closer than the wire's thickness.

    Depth is ignored: where two paths cross as seen from above, one may pass below the other.
    """
    paths = [suture.path_ends_m for suture in sutures]
    return tuple(
        (i, j)
        for i, j in combinations(range(len(paths)), 2)
        if _distance_m(paths[i], paths[j]) < sutures[i].setup.needle.wire_m
    )


def _distance_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the distance between two line segments (2, 2) in the plane."""
    if _parts(one, other) and _parts(other, one):
        return 0.0
    ends = [(end, segment) for points, segment in ((one, other), (other, one)) for end in points]
    return min(_from_segment_m(end, segment) for end, segment in ends)


def _parts(line: NDArray[np.float64], segment: NDArray[np.float64]) -> bool:
    """Return whether the ends of a segment lie on opposite sides of the line through another."""
    along, to_ends = line[1] - line[0], segment - line[0]
    sides = along[0] * to_ends[:, 1] - along[1] * to_ends[:, 0]
    return bool(sides[0] * sides[1] < 0)


def _from_segment_m(point: NDArray[np.float64], segment: NDArray[np.float64]) -> float:
    along, to_point = segment[1] - segment[0], point - segment[0]
    share = np.clip(to_point @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(to_point - share * along))
