"""Everything that happened in a simulated cell, tick by tick. Simulator truth, for referees, files and replays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.sim.contacts import Collision


@dataclass(frozen=True, eq=False)
class Record:
    """The true state at every tick.

    Attributes:
        times_s: (n,) clock of the cell, 100 Hz; the first is 0.
        joints: (n, 7) true joints and jaw opening of each arm, by name.
        T_world_body: (n,) true poses of the bodies that are free, by name.
        T_world_tip: (n,) true tips of the arms, by name.
        collisions: in order of time.
    """

    times_s: NDArray[np.float64]
    joints: Mapping[str, NDArray[np.float64]]
    T_world_body: Mapping[str, SE3]
    T_world_tip: Mapping[str, SE3]
    collisions: tuple[Collision, ...]

    def row(self, time_s: float) -> int:
        """Return the row of the last tick not after this time."""
        return max(0, int(np.searchsorted(self.times_s, time_s + 1e-9)) - 1)

    def rows(self, start_s: float, end_s: float) -> slice:
        """Return the rows between two times, both included."""
        first, last = np.searchsorted(self.times_s, [start_s - 1e-9, end_s + 1e-9])
        return slice(int(first), int(last))
