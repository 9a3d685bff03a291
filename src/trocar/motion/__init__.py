"""Motion in joint space: problems, planners, checked plans, simple moves, limits, duration bounds, distances."""

from trocar.motion.bodies import Capsule, HalfSpace, MovingArm, Obstacle, open_box, wall
from trocar.motion.check import vertical_deviation_m
from trocar.motion.clearance import Clearance, swept_clearance
from trocar.motion.double_integrator import duration_bound_s
from trocar.motion.limits import LimitUse, limit_use
from trocar.motion.moves import move_to, rest_to_rest
from trocar.motion.plan import MotionPlan, plan_motion, plan_through
from trocar.motion.planners import PLANNERS, Demand, Planner, TimedPath, ignores
from trocar.motion.problem import ArmMotion, Facing, MotionProblem
from trocar.motion.straight_line import straight

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
    "move_to",
    "open_box",
    "plan_motion",
    "plan_through",
    "rest_to_rest",
    "straight",
    "swept_clearance",
    "vertical_deviation_m",
    "wall",
]
