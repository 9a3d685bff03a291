"""Planners: functions from a problem to paths, by name; built in, from packages, or from a user's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import reduce
from typing import Any, TypeVar

import numpy as np

from trocar.checks import takes
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite
from trocar.motion.problem import MotionProblem
from trocar.registry import Lazy, Registry
from trocar.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A planner's answer for one arm: a trajectory through the waypoints.

    Attributes:
        trajectory: of the joints; its first knot is the common start of all arms.
        waypoint_times_s: (n,) when it passes the waypoints, the first at its start.
    """

    trajectory: Trajectory
    waypoint_times_s: Array

    def __post_init__(self) -> None:
        if not isinstance(self.trajectory, Trajectory):
            raise InvalidInput("a timed path", f"needs a Trajectory, got {type(self.trajectory).__name__}")
        object.__setattr__(self, "waypoint_times_s", finite("the waypoints' times", self.waypoint_times_s, "n"))

    def __repr__(self) -> str:
        return f"<TimedPath through {len(self.waypoint_times_s)} waypoints: {self.trajectory.duration_s:.3f} s>"

    @classmethod
    def joined(cls, moves: Sequence[Trajectory]) -> TimedPath:
        """Return the path of consecutive moves, each of which ends at the next waypoint.

        >>> path = TimedPath.joined([rest_to_rest(a, b, limits) for a, b in pairwise(waypoints)])
        """
        times = np.cumsum([0.0, *(move.duration_s for move in moves)])
        return cls(reduce(Trajectory.then, moves), times)


Planner = Callable[[MotionProblem], Mapping[str, TimedPath]]
"""A function that returns one path per arm for a problem, or raises a ``TrocarError`` that says why there is none.

It gets a checked problem with joint waypoints only. Its answers are not trusted: :func:`trocar.motion.plan_motion`
checks them, so the planner need not.
"""


def _require_planner(name: str, planner: Any) -> None:
    if not (callable(planner) and takes(planner, 1)):
        raise InvalidInput(f"planner {name!r}", f"is {planner!r}", "register a function of a MotionProblem")


PLANNERS: Registry[Planner] = Registry(
    "planner",
    "trocar.planners",
    {
        "spline": Lazy("trocar.motion.splines:spline"),
        "sqp": Lazy("trocar.motion.sqp:sqp"),
        "optimal": Lazy("trocar.motion.optimal:optimal"),
        "convex": Lazy("trocar.motion.convex:convex"),
    },
    check=_require_planner,
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
    """Declare which demands a planner ignores; a refusal names those that its motion violates.

    >>> @ignores(Demand.STRAIGHT, Demand.DISTANCES)
    ... def stop_and_go(problem): ...
    """

    def declare(planner: P) -> P:
        planner.ignores = frozenset(demands)  # type: ignore[attr-defined]
        return planner

    return declare
