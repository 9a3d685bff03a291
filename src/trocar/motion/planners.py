"""The planners by name: built in, from installed packages, or from a user's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import TypeVar

from trocar.motion.path import TimedPath
from trocar.motion.problem import MotionProblem
from trocar.registry import Lazy, Registry

Planner = Callable[[MotionProblem], Mapping[str, TimedPath]]
"""A function that returns one path per arm for a problem, or raises a ``TrocarError`` that says why there is none.

It gets a checked problem with joint waypoints only. Its answers are not trusted: :func:`trocar.motion.plan_motion`
checks them, so the planner need not.
"""

PLANNERS: Registry[Planner] = Registry(
    "planner",
    "trocar.planners",
    {
        "spline": Lazy("trocar.motion.splines:spline"),
        "sqp": Lazy("trocar.motion.sqp:sqp"),
        "optimal": Lazy("trocar.motion.optimal:optimal"),
        "convex": Lazy("trocar.motion.convex:convex"),
    },
)
"""Every planner; other packages add theirs as entry points ``trocar.planners``, files by ``PLANNERS.register``."""


class Demand(Enum):
    """The demands that a problem can make on a motion."""

    WAYPOINTS = "waypoints"
    LIMITS = "limits"
    JERK = "jerk"
    RANGES = "ranges"
    STRAIGHT = "straight pieces"
    DISTANCES = "distances"
    TIP_SPEED = "the speed of the tip"
    FACING = "what the tip faces"


P = TypeVar("P", bound=Planner)


def ignores(*demands: Demand) -> Callable[[P], P]:
    """Declare which demands a planner ignores, to be reported where that matters.

    >>> @ignores(Demand.STRAIGHT, Demand.DISTANCES)
    ... def stop_and_go(problem): ...
    """

    def declare(planner: P) -> P:
        planner.ignores = frozenset(demands)  # type: ignore[attr-defined]
        return planner

    return declare


def ignored(planner: Planner) -> frozenset[Demand]:
    """Return the demands that a planner declared it ignores."""
    return getattr(planner, "ignores", frozenset())
