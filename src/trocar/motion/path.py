"""A planner's answer for one arm: a trajectory, and when it passes the waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry.arrays import finite
from trocar.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A trajectory through waypoints.

    Attributes:
        trajectory: of the joints; its first knot is the common start of all arms.
        waypoint_times_s: (n,) when it passes the waypoints, the first at its start.
    """

    trajectory: Trajectory
    waypoint_times_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not isinstance(self.trajectory, Trajectory):
            raise InvalidInput("a timed path", f"needs a Trajectory, got {type(self.trajectory).__name__}")
        object.__setattr__(self, "waypoint_times_s", finite("the waypoints' times", self.waypoint_times_s, "n"))

    def __repr__(self) -> str:
        return f"<TimedPath through {len(self.waypoint_times_s)} waypoints: {self.trajectory.duration_s:.3f} s>"

    @classmethod
    def joined(cls, moves: Sequence[Trajectory]) -> TimedPath:
        """Return the moves one after the other, each of which ends at the next waypoint.

        >>> path = TimedPath.joined([rest_to_rest(a, b, limits) for a, b in pairwise(waypoints)])
        """
        times = np.cumsum([0.0, *(move.duration_s for move in moves)])
        return cls(reduce(Trajectory.then, moves), times)
