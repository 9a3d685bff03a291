"""A suture plan as plain values, and what is wrong with it.

Sutures may be out of reach (where, which joint, by how much), cross in the tissue, reach over the mesh's edge, or never
come out of the tissue.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk, ik_branches
from trocar.geometry import TURN, shown
from trocar.geometry.capsules import segment_distances_m
from trocar.log import plain
from trocar.tasks.suture.planning.clearance import APART_M, OFF_WALL_M
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan, setup_values
from trocar.tasks.suture.planning.primitive import (
    LIMIT_TOLERANCE,
    ROLL,
    Suture,
    SutureJoints,
    jaws_above_m,
    path_samples,
    suture_joints,
    sutures_at,
    tip_poses,
    unwound,
    with_clearances,
)
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import CLOCKWISE, DIRECTION_NAMES, SutureSetup

REMEDY = "move the base, turn the grasp or change the circle's radius"
ARCS_NAMED, PAIRS_NAMED = 3, 3


def plan_summary(map: DexterityMap, plan: SuturePlan) -> dict[str, Any]:
    """Return a plan for this map's setup, and the reasons for it, as plain values with angles in degrees."""
    setup, reward = map.setup, map.reward
    sutures = sutures_at(setup, plan.positions_rad, plan.directions)
    problem = "" if plan.feasible else circle_out_of_reach(map.joints) or plan_out_of_reach(sutures)
    found = {
        "positions_deg": _degrees(plan.positions_rad),
        **bites(sutures),
        "directions": [suture.direction for suture in sutures],
        "direction_names": [DIRECTION_NAMES[suture.direction] for suture in sutures],
        "rewards": plan.rewards.tolist(),
        "gaps_deg": _degrees(plan.gaps_rad),
        **_asked(plan),
        "joint_room": joint_room(setup, plan),
        "reward": plan.reward,
        "bound": plan.bound,
        "certified": plan.certified,
        "feasible": plan.feasible,
        "problem": problem,
        "arm": setup.arm.name,
        "setup": setup_values(setup),
        "margin": reward.margin,
        "weight": reward.weight,
        "margin_at": reward.at,
        "feasible_first": reward.feasible_first,
        "joint_weights": list(reward.joint_weights),
        "caution": reward.caution,
        "grid_positions": len(map.thetas_rad),
        "manipulability_source": map.source,
        "switches_deg": _degrees(map.switches_rad),
        "unreachable_deg": unreachable_arcs(map.joints),
        **tissue_summary(setup, plan),
        "jaws_can_hold_needle": setup.grasp.holdable,
        "wire_out_of_jaws_deg": math.degrees(setup.grasp.out_of_jaws_rad),
    }
    return plain(found)


def _asked(plan: SuturePlan) -> dict[str, Any]:
    """Return the constraints on the positions."""
    spacing = plan.spacing or Spacing.even(len(plan.positions_rad))
    return {
        "gap_bounds_deg": _degrees(np.array([spacing.min_gap_rad, spacing.max_gap_rad])),
        "forbidden_deg": [_degrees(np.array(arc)) for arc in spacing.forbidden_rad],
        "fixed_deg": _degrees(np.array(spacing.fixed_rad)),
    }


def bites(sutures: Sequence[Suture]) -> dict[str, Any]:
    """Return where sutures enter, hold and come out, as angles round the circle, and the gaps between their mid-bites.

    If a needle never comes out, the place where its tip stops counts as its exit.
    """
    ends = np.stack([suture.ends_m for suture in sutures])
    angles = [np.arctan2(at[:, 1], at[:, 0]) % TURN for at in (ends[:, 0], ends[:, 1], ends.mean(1))]
    middle = np.sort(angles[2])
    names = ("entries_deg", "exits_deg", "mid_bites_deg")
    found = {name: _degrees(at) for name, at in zip(names, angles, strict=True)}
    return found | {"mid_bite_gaps_deg": _degrees(np.diff(middle, append=middle[0] + TURN))}


def mesh_left_m(setup: SutureSetup) -> float:
    """Return how far the bites stay from the mesh's edge, wherever they are; below 0 they reach over it."""
    suture = Suture(setup, 0.0, CLOCKWISE)
    ends = np.concatenate([suture.ends_m, suture.path_ends_m])
    return setup.circle.mesh_radius_m - float(np.linalg.norm(ends, axis=1).max())


def joint_room(setup: SutureSetup, plan: SuturePlan) -> list[dict[str, float]]:
    """Return how far each joint stays from the nearer end of its range along each suture, by its name and unit."""
    arm, joints = setup.arm, suture_joints(setup, plan.positions_rad)
    rows = [suture.row for suture in sutures_at(setup, plan.positions_rad, plan.directions)]
    q = joints.q[rows, np.arange(len(rows))]
    left = np.minimum(q - arm.lower, arm.upper - q).min(1)
    left = left * np.array([joint.shown_scale[0] for joint in arm.joints])
    names = [f"{joint.name}_{joint.shown_scale[1]}" for joint in arm.joints]
    return [dict(zip(names, row, strict=True)) for row in left.tolist()]


def _degrees(angles_rad: NDArray[np.float64]) -> list[float]:
    """Return angles in degrees, rounded to remove the error of the conversion."""
    return np.degrees(angles_rad).round(9).tolist()


# Out of reach.


def unreachable_arcs(joints: SutureJoints) -> list[dict[str, Any]]:
    """Return the arcs of these evenly spaced positions at which no direction is feasible, longest first.

    Each has the first and the last position counterclockwise, ``from`` and ``to`` in degrees, and the ``reason``: what
    the better direction would need at the worst position.
    """
    blocked = np.logical_not(joints.feasible.any(0))
    n = len(joints.thetas_rad)
    if not blocked.any():
        return []
    excess = relative_excess(joints).max(-1)
    starts = np.flatnonzero(blocked & ~np.roll(blocked, 1)) if not blocked.all() else np.array([0])
    lengths = [n if blocked.all() else int(np.argmin(np.roll(blocked, -start))) for start in starts]
    arcs = []
    for start, length in sorted(zip(starts, lengths, strict=True), key=lambda arc: -arc[1]):
        where = (start + np.arange(length)) % n
        worst = int(where[np.argmax(excess.min(0)[where])])
        first, last = (math.degrees(joints.thetas_rad[where[end]]) for end in (0, -1))
        reason = _reason(joints, int(np.argmin(excess[:, worst])), worst)
        arcs.append({"from": first, "to": last, "reason": reason})
    return arcs


def circle_out_of_reach(joints: SutureJoints) -> str:
    """Return one sentence on all arcs that are out of reach in both directions; empty if there are none."""
    arcs = unreachable_arcs(joints)
    if not arcs:
        return ""
    if (height_m := jaws_above_m(joints.setup)) < 0:
        under = f"the jaws would be {shown(-height_m, 'm', '.2g')} under the tissue, wherever the suture is"
        return f"{under}; hold the needle farther behind its tip, or turn the grasp"
    if misplaced := misplaced_port(joints.setup):
        return f"{misplaced}; move the port{' or the wall' if joints.setup.wall.up_m else ''}"
    all_around = not joints.feasible.any()
    parts = [f"at {'all positions' if all_around else _span(arc)} {arc['reason']}" for arc in arcs[:ARCS_NAMED]]
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
    """Return by how much (2, n, 10) sutures violate each constraint, as shares; 0 where they do not.

    First the six joints, as shares of their ranges; then the wrist's depth, as a share of the safe depth; then the
    distances from tissue, body wall and second arm, as shares of the fingers' length. If the second arm cannot pull the
    needle through, the last share is next to nothing, but not 0.
    """
    arm = joints.arm
    arms_apart_m = np.where(np.isneginf(joints.arms_apart_m), -LIMIT_TOLERANCE, joints.arms_apart_m)
    shares = (
        *np.moveaxis(joints.excess / (arm.upper - arm.lower), -1, 0),
        joints.too_shallow_m / arm.safe_depth_m,
        *(
            np.maximum(-clear_m, 0.0) / arm.instrument.finger_length_m
            for clear_m in (joints.above_tissue_m, joints.inside_wall_m, arms_apart_m)
        ),
    )
    return np.stack(shares, axis=-1)


def _reason(joints: SutureJoints, row: int, position: int) -> str:
    """Return in words what the suture at this position, in this row of ``DIRECTIONS``, would need."""
    arm = joints.arm
    if misplaced := misplaced_port(joints.setup):
        return misplaced
    if np.isneginf(joints.arms_apart_m[row, position]):
        return "the second arm cannot pull the needle through"
    if not np.isfinite(joints.q[row, position]).all():
        return "no configuration of the arm holds the needle as planned"
    nearest = _on_nearest_branch(joints, row, position)
    q, worst = nearest.q[0, 0], int(np.argmax(relative_excess(nearest)))
    if worst >= len(arm.joints):
        return _in_the_way(nearest, worst - len(arm.joints))
    joint, values = arm.joints[worst], q[:, worst]
    over, under = float(values.max()) - joint.upper, joint.lower - float(values.min())
    limit, excess, sign = (joint.upper, over, 1) if over >= under else (joint.lower, under, -1)
    return (
        f"joint '{joint.name}' would reach {joint.shown(limit + sign * excess)}, {joint.shown(excess)} "
        f"beyond its limit of {joint.shown(limit, '.0f')}"
    )


def misplaced_port(setup: SutureSetup) -> str:
    """Return in words which port lies in the tissue or outside of the body wall; empty if none does."""
    if (height_m := setup.port_above_tissue_m) < 0:
        return f"the port would lie {shown(-height_m, 'm')} under the tissue's surface"
    ports = {"the port": setup.T_world_base.translation_m}
    ports |= {"the second arm's port": setup.puller.port_m} if setup.puller.up_m else {}
    for name, port_m in ports.items():
        if abs(off_m := setup.wall.port_off_m(port_m)) > 1e-9:
            return f"{name} would lie {shown(abs(off_m), 'm')} {'above' if off_m > 0 else 'below'} the body wall"
    return ""


def _in_the_way(joints: SutureJoints, which: int) -> str:
    """Return in words what one suture lacks: depth (0), distance from tissue (1), body wall (2) or second arm (3)."""
    if which == 0:
        safe_m, short_m = joints.arm.safe_depth_m, joints.too_shallow_m[0, 0]
        return (
            f"the wrist would be {shown(safe_m - short_m, 'm')} beyond the remote centre, "
            f"{shown(short_m, 'm')} less than the safe depth of {shown(safe_m, 'm', '.0f')}"
        )
    if which == 1:
        return f"the instrument would be {shown(-joints.above_tissue_m[0, 0], 'm', '.2g')} under the tissue"
    if which == 2:
        left = _clearance(joints.inside_wall_m[0, 0], OFF_WALL_M, "in the body wall", "from the body wall")
        return f"instrument or needle would be {left}"
    left = _clearance(joints.arms_apart_m[0, 0], APART_M, "inside each other", "apart")
    return f"where the second arm comes to the needle's tip, the instruments would be {left}"


def _clearance(left_m: float, asked_m: float, within: str, off: str) -> str:
    """Return in words how far apart two things are; ``left_m`` is that distance less the required ``asked_m``."""
    if left_m + asked_m < 0:
        return f"{shown(-left_m - asked_m, 'm')} {within}"
    return f"{shown(left_m + asked_m, 'm')} {off}, {shown(-left_m, 'm')} less than {shown(asked_m, 'm', '.0f')}"


def _on_nearest_branch(joints: SutureJoints, row: int, position: int) -> SutureJoints:
    """Return one suture on the branch of the inverse kinematics that violates the constraints least.

    The arm's usual branch may violate them far more: it may put the wrist on the other side of the remote centre where
    another branch only exceeds the range of a wrist joint.
    """
    arm, samples = joints.arm, path_samples(joints.setup)
    q, real = ik_branches(arm, fk(arm, joints.q[row, position]))
    q = np.moveaxis(q[:, real.all(0)], 1, 0)
    q[..., ROLL] = unwound(q[..., ROLL], arm.middle_floats[ROLL])
    T_circle_tip = tip_poses(joints.setup, samples.advance_m, samples.jaws_rad)[row : row + 1]
    found = []
    for one in q[:, None, None]:
        here = joints.thetas_rad[[position]]
        found.append(with_clearances(joints.setup, here, one, samples, T_circle_tip, slice(row, row + 1)))
    return min(found, key=lambda one: relative_excess(one).max())


def _span(arc: Mapping[str, Any]) -> str:
    first, last = arc["from"], arc["to"]
    return f"{first:.4g} deg" if first == last else f"{first:.4g} to {last:.4g} deg"


# In the tissue.


def crossing_sutures(sutures: Sequence[Suture]) -> list[tuple[int, int]]:
    """Return the pairs of sutures whose paths, seen from above, cross or come closer than the wire's thickness.

    Depth is ignored: where two paths cross as seen from above, one may pass below the other.
    """
    pairs = list(combinations(range(len(sutures)), 2))
    if not pairs:
        return []
    paths = np.stack([suture.path_ends_m for suture in sutures])
    one, other = paths[np.array(pairs)].swapaxes(0, 1)
    near = segment_distances_m(one[:, 0], one[:, 1], other[:, 0], other[:, 1]) < sutures[0].setup.needle.wire_m
    return [pair for pair, meet in zip(pairs, near, strict=True) if meet]


def tissue_summary(setup: SutureSetup, plan: SuturePlan) -> dict[str, Any]:
    """Return which sutures cross, how far from its edge they hold the mesh, and whether the needle comes out."""
    pairs = crossing_sutures(sutures_at(setup, plan.positions_rad, plan.directions))
    exit_rad = setup.exit_turn_rad
    return {
        "mesh_left_mm": 1e3 * mesh_left_m(setup),
        "mesh_margin_mm": 1e3 * setup.circle.mesh_margin_m,
        "crossing_deg": [[round(math.degrees(plan.positions_rad[i]), 9) for i in pair] for pair in pairs],
        "needle_comes_out": setup.comes_out,
        "needle_turn_deg": math.degrees(setup.insertion.turn_rad),
        "needle_exit_turn_deg": None if math.isnan(exit_rad) else math.degrees(exit_rad),
    }


def tissue_warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return one sentence per problem in the tissue, from the values of ``tissue_summary``."""
    found = []
    if pairs := summary["crossing_deg"]:
        named = ", ".join(f"{one:.4g} and {other:.4g}" for one, other in pairs[:PAIRS_NAMED])
        more = f" and {len(pairs) - PAIRS_NAMED} more pairs" if len(pairs) > PAIRS_NAMED else ""
        found.append(
            f"warning: sutures cross in the tissue, seen from above: {named} deg{more}; ask for wider gaps or fewer "
            "sutures, a larger circle or a smaller needle"
        )
    left, asked = summary["mesh_left_mm"], summary["mesh_margin_mm"]
    if left < asked - 1e-9:
        where = f"reach {-left:.1f} mm over the mesh's edge" if left < 0 else f"come within {left:.1f} mm of its edge"
        found.append(
            f"warning: the sutures may not hold the mesh: their bites {where}, and {asked:g} mm should be left; widen "
            "the mesh (circle_mesh_beyond_mm), take a smaller needle or, where theta is the entry, let it be the middle"
        )
    if not summary["needle_comes_out"]:
        out = summary["needle_exit_turn_deg"]
        enough = "but no rotation brings its tip out" if out is None else f"but its tip comes out at {out:.1f} deg"
        found.append(
            f"warning: the needle never comes out of the tissue: it is turned by {summary['needle_turn_deg']:.1f} deg, "
            f"{enough}; {'shorten the straight path' if out is None else 'turn it farther or push it more often'}"
        )
    return found
