"""Motion requests for tests of planners, and a sound planner for tests to break."""

from itertools import pairwise

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS, ik
from trocar.geometry import SE3, SO3
from trocar.motion import ArmMotion, TimedPath, move_to

PSM = ARMS["psm-classic"]
PAPER = MOTION_LIMITS["paper"]


def transfer_waypoints():
    """Return joints (4, 6) of a transfer: grasp, lifted, over the target, lowered; the tool turns a little."""
    places_m = [[0.140, -0.020, -0.155], [0.140, -0.020, -0.115], [0.100, 0.020, -0.115], [0.100, 0.020, -0.145]]
    turns = SO3.axis("z", [0.5, 0.5, -0.2, -0.2])
    return ik(PSM, SE3.from_parts(turns, places_m))


FOUR = transfer_waypoints()


def leaning_base(x_m, lean_rad):
    """Return the pose of a base 150 mm above the table, leaning along x."""
    return SE3.from_parts(SO3.axis("y", lean_rad), [x_m, 0.0, 0.15])


LEFT, RIGHT = leaning_base(-0.08, -0.4), leaning_base(0.08, 0.4)


def over_the_table(T_world_base, places_m, turn_rad=0.0, **asked):
    """Return one PSM's motion from place to place (n, 3) over the table z = 0, tool straight down."""
    T_world_tips = SE3.from_parts(SO3.axis("z", turn_rad), np.array(places_m, dtype=float))
    waypoints = ik(PSM, T_world_base.inverse() @ T_world_tips)
    up = T_world_base.matrix[2, :3]
    return ArmMotion(PSM, waypoints, PAPER, T_world_base=T_world_base, up=up, **asked)


def transfer(T_world_base, pick_m, place_m, turn_rad=0.0, lift_m=0.03, **asked):
    """Return the motion of a transfer from one place (x, y) of the table to another."""
    places = [[*pick_m, 0.0], [*pick_m, lift_m], [*place_m, lift_m], [*place_m, 0.0]]
    return over_the_table(T_world_base, places, turn_rad, **asked)


def stops(problem):
    """Plan motions that come to rest at every waypoint: a sound planner."""
    return {
        name: TimedPath.joined(
            [
                move_to(a, arm.start_velocity * (k == 0), b, arm.limits)
                for k, (a, b) in enumerate(pairwise(arm.waypoints))
            ]
        )
        for name, arm in problem.arms.items()
    }
