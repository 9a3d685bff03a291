"""Motions in joint space: splines through waypoints, plain and straight moves, limits, a bound."""

from trocar.motion.bound import duration_bound_s, shortest_rest_to_rest_s
from trocar.motion.limits import LimitUse, limit_use
from trocar.motion.moves import rest_to_rest, straight
from trocar.motion.plan import PLANNERS, Plan, PlanQuality, assess_transfer, plan_through, plan_transfer

__all__ = [
    "PLANNERS",
    "LimitUse",
    "Plan",
    "PlanQuality",
    "assess_transfer",
    "duration_bound_s",
    "limit_use",
    "plan_through",
    "plan_transfer",
    "rest_to_rest",
    "shortest_rest_to_rest_s",
    "straight",
]
