"""A suture plan as plain values, which the command prints and saves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.suture.planning.joints import SutureJoints, suture_joints
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.plan_file import setup_values
from trocar.tasks.suture.planning.reach import circle_out_of_reach, plan_out_of_reach, unreachable_arcs
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS
from trocar.tasks.suture.report.plan.tissue import tissue_summary


def plan_summary(map: DexterityMap, plan: SuturePlan) -> dict[str, Any]:
    """Return a plan and the reasons for it as plain values, angles in degrees.

    Args:
        map: dexterity of all sutures.
        plan: a plan for this map's setup.
    """
    setup, reward = map.setup, map.reward
    joints = suture_joints(setup, plan.positions_rad)
    arcs = unreachable_arcs(map.joints)
    problem = "" if plan.feasible else circle_out_of_reach(map.joints) or plan_out_of_reach(setup, plan)
    found = {
        "positions_deg": _degrees(plan.positions_rad),
        "directions": [int(direction) for direction in plan.directions],
        "direction_names": [DIRECTION_NAMES[int(direction)] for direction in plan.directions],
        "rewards": [float(value) for value in plan.rewards],
        "gaps_deg": _degrees(plan.gaps_rad),
        "joint_room": [dict(zip(room_names(joints), row, strict=True)) for row in room(joints, plan).tolist()],
        "reward": plan.reward,
        "tension_cost": plan.tension_cost,
        "value": plan.value,
        "bound": plan.bound,
        "certified": plan.certified,
        "feasible": plan.feasible,
        "problem": problem,
        "arm": setup.arm.name,
        "setup": setup_values(setup),
        "margin": reward.margin,
        "weight": reward.weight,
        "scaling": reward.scaling,
        "joints": reward.joints,
        "margin_at": reward.at,
        "feasible_first": reward.feasible_first,
        "grid_positions": len(map.thetas_rad),
        "manipulability_source": map.source,
        "switches_deg": _degrees(map.switches_rad),
        "unreachable_deg": [
            {"from": float(np.degrees(arc.from_rad)), "to": float(np.degrees(arc.to_rad)), "reason": arc.reason}
            for arc in arcs
        ],
        **tissue_summary(setup, plan),
        "jaws_can_hold_needle": setup.grasp.holdable,
        "wire_out_of_jaws_deg": float(np.degrees(setup.grasp.out_of_jaws_rad)),
    }
    return finite(found)


def finite(value: Any) -> Any:
    """Return plain values with None in place of numbers that are not finite, which JSON lacks."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def room(joints: SutureJoints, plan: SuturePlan) -> NDArray[np.float64]:
    """Return how far (n, 6) each joint stays from the nearer end of its range along each suture, deg or mm.

    Args:
        joints: configurations at the plan's positions.
        plan: gives the directions.
    """
    rows = np.array([DIRECTIONS.index(int(direction)) for direction in plan.directions])
    q = joints.q[rows, np.arange(len(rows))]
    arm = joints.arm
    left = np.minimum(q - arm.lower, arm.upper - q).min(1)
    return left * np.array([joint.shown_scale[0] for joint in arm.joints])


def room_names(joints: SutureJoints) -> list[str]:
    """Return a name with its unit for each column of ``room``."""
    return [f"{joint.name}_{joint.shown_scale[1]}" for joint in joints.arm.joints]


def _degrees(angles_rad: NDArray[np.float64]) -> list[float]:
    """Return angles in degrees, rounded to remove the error of the conversion."""
    return np.degrees(angles_rad).round(9).tolist()
