"""Add a planner: one function and one line in a dict, then every command knows it: python examples/own_planner.py."""

from functools import reduce
from itertools import pairwise

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS, ArmModel, MotionLimits, ik
from trocar.geometry import SE3, SO3
from trocar.motion import PLANNERS, assess_transfer, plan_transfer, rest_to_rest
from trocar.trajectory import Trajectory


def stop_and_go(
    arm: ArmModel, waypoints: np.ndarray, limits: MotionLimits, up: np.ndarray
) -> tuple[Trajectory, np.ndarray]:
    """Come to rest at every waypoint; ``arm`` and ``up`` are for planners that care."""
    moves = [rest_to_rest(a, b, limits) for a, b in pairwise(waypoints)]
    times_s = np.cumsum([0.0, *(move.duration_s for move in moves)])
    return reduce(Trajectory.then, moves), times_s


PLANNERS["stop-and-go"] = stop_and_go

arm, limits = ARMS["psm-classic"], MOTION_LIMITS["paper"]
tips_m = [[0.14, -0.02, -0.155], [0.14, -0.02, -0.115], [0.10, 0.02, -0.115], [0.10, 0.02, -0.145]]
waypoints = ik(arm, SE3.from_parts(SO3.axis("z", [0.5, 0.5, -0.2, -0.2]), tips_m))
for name in PLANNERS:
    quality = assess_transfer(arm, plan_transfer(arm, waypoints, limits, planner=name), limits)
    print(f"{name}: {quality.duration_s:.3f} s, no motion is below {quality.bound_s:.3f} s")
