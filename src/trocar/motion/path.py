"""What a planner answers for one arm: a trajectory, and when it passes the waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

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
        object.__setattr__(self, "waypoint_times_s", np.asarray(self.waypoint_times_s, dtype=np.float64))

    @classmethod
    def joined(cls, moves: Sequence[Trajectory]) -> TimedPath:
        """Return the moves one after the other, each of which ends at the next waypoint.

        >>> path = TimedPath.joined([rest_to_rest(a, b, limits) for a, b in pairwise(waypoints)])
        """
        times = np.cumsum([0.0, *(move.duration_s for move in moves)])
        return cls(reduce(Trajectory.then, moves), times)
