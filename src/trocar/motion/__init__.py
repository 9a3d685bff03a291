"""Motions in joint space: from a problem to a checked plan; planners by name; plain moves; limits, bound, distances."""

from trocar.motion.arm_motion import ArmMotion
from trocar.motion.bound import duration_bound_s, shortest_rest_to_rest_s, shortest_to_rest_s
from trocar.motion.clearance import Clearance, swept_clearance
from trocar.motion.facing import Facing
from trocar.motion.limits import LimitUse, limit_use
from trocar.motion.moves import move_to, rest_to_rest, straight
from trocar.motion.moving_arm import MovingArm
from trocar.motion.obstacles import Capsule, HalfSpace, Obstacle, open_box, wall
from trocar.motion.path import TimedPath
from trocar.motion.plan import MotionPlan, plan_motion, plan_through
from trocar.motion.planners import PLANNERS, Demand, Planner, ignores
from trocar.motion.problem import MotionProblem
from trocar.motion.tolerances import line_deviation, vertical_deviation_m

__all__ = [
    "PLANNERS",
    "ArmMotion",
    "Capsule",
    "Clearance",
    "Demand",
    "Facing",
    "HalfSpace",
    "LimitUse",
    "MotionPlan",
    "MotionProblem",
    "MovingArm",
    "Obstacle",
    "Planner",
    "TimedPath",
    "duration_bound_s",
    "ignores",
    "limit_use",
    "line_deviation",
    "move_to",
    "open_box",
    "plan_motion",
    "plan_through",
    "rest_to_rest",
    "shortest_rest_to_rest_s",
    "shortest_to_rest_s",
    "straight",
    "swept_clearance",
    "vertical_deviation_m",
    "wall",
]
