"""Explanations why a suture or a part of the circle is out of reach: which positions, which joint, by how much."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import shown
from trocar.tasks.suture.planning.joints import SutureJoints, suture_joints
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.plan_file import PlannedSutures
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS, SutureSetup

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
    lacking = _lacking(joints).max(-1).min(0)
    starts = np.flatnonzero(blocked & ~np.roll(blocked, 1)) if not blocked.all() else np.array([0])
    lengths = [n if blocked.all() else int(np.argmin(np.roll(blocked, -start))) for start in starts]
    arcs = []
    for start, length in sorted(zip(starts, lengths, strict=True), key=lambda arc: -arc[1]):
        where = (start + np.arange(length)) % n
        worst = int(where[np.argmax(lacking[where])])
        easier = int(np.argmin(_lacking(joints)[:, worst].max(-1)))
        reason = _reason(joints, easier, worst)
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


def plan_out_of_reach(setup: SutureSetup, plan: SuturePlan | PlannedSutures) -> str:
    """Return one sentence on the infeasible sutures of a plan; empty if all are feasible."""
    joints = suture_joints(setup, plan.positions_rad)
    rows = [DIRECTIONS.index(int(direction)) for direction in plan.directions]
    parts = [
        f"at {shown(theta, 'rad', '.4g')} {DIRECTION_NAMES[DIRECTIONS[row]]} {_reason(joints, row, i)}"
        for i, (theta, row) in enumerate(zip(plan.positions_rad, rows, strict=True))
        if not joints.feasible[row, i]
    ]
    return f"the plan is out of reach: {'; '.join(parts)}; {REMEDY}" if parts else ""


def _lacking(joints: SutureJoints) -> NDArray[np.float64]:
    """Return by how much (2, n, 7) each joint leaves its range, as a share of it, and likewise for the safe depth."""
    arm = joints.arm
    of_ranges = joints.excess / (arm.upper - arm.lower)
    return np.concatenate([of_ranges, joints.too_shallow_m[..., None] / arm.safe_depth_m], axis=-1)


def _reason(joints: SutureJoints, row: int, position: int) -> str:
    """Return in words what the suture at this position, in this row of ``DIRECTIONS``, would need."""
    q = joints.q[row, position]
    if not np.isfinite(q).all():
        return "no configuration of the arm holds the needle as planned"
    lacking = _lacking(joints)[row, position]
    worst = int(np.argmax(lacking))
    if worst == len(lacking) - 1:
        lacking_m, safe_m = joints.too_shallow_m[row, position], joints.arm.safe_depth_m
        return (
            f"the wrist would be {shown(safe_m - lacking_m, 'm')} beyond the remote centre, "
            f"{shown(lacking_m, 'm')} less than the safe depth of {shown(safe_m, 'm', '.0f')}"
        )
    return _beyond(joints.arm, worst, q[:, worst])


def _beyond(arm: ArmModel, index: int, values: NDArray[np.float64]) -> str:
    """Return in words how far a joint would leave its range."""
    joint = arm.joints[index]
    over, under = float(values.max()) - joint.upper, joint.lower - float(values.min())
    limit, way = (joint.upper, 1) if over >= under else (joint.lower, -1)
    excess = max(over, under)
    return (
        f"joint '{joint.name}' would reach {joint.shown(limit + way * excess)}, {joint.shown(excess)} "
        f"beyond its limit of {joint.shown(limit, '.0f')}"
    )


def _span(arc: Arc, positions: int) -> str:
    """Return the extent of an arc in words."""
    first, last = math.degrees(arc.from_rad), math.degrees(arc.to_rad)
    if abs((last - first) % 360.0 - (360.0 - 360.0 / positions)) < 1e-6:
        return "all positions"
    return f"{first:.4g} deg" if first == last else f"{first:.4g} to {last:.4g} deg"
