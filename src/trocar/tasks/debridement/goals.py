"""Goals of debridement, what is known of the work surface beforehand, and outcomes of handling a fragment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Outcome


class Clearing(NamedTuple):
    """One goal: one more fragment rests in the receptacle. Number 0 is the first one cleared, whichever it is."""

    number: int


@dataclass(frozen=True)
class Receptacle:
    """An open box on the work surface; origin of its frame in the middle of its floor, z up, x along its length."""

    size_m: tuple[float, float] = (0.110, 0.070)  # inner length and width; 11 x 7 cm (Kehoe 2014, VI)
    height_m: float = 0.012  # of its walls (assumed)
    wall_m: float = 0.002  # their thickness (assumed)

    def holds(self, p_receptacle: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether points (..., 3) in the receptacle's frame lie between its walls, below their edge."""
        inside = np.abs(p_receptacle[..., :2]) < 0.5 * np.array(self.size_m)
        return inside.all(axis=-1) & (p_receptacle[..., 2] < self.height_m)


@dataclass(frozen=True)
class Workspace:
    """The plane work surface as given to an agent."""

    receptacle: Receptacle = field(default_factory=Receptacle)  # its pose is the fixture ``receptacle``
    # Corners x, y in the world of the rectangle in which fragments may lie.
    region_m: tuple[tuple[float, float], tuple[float, float]] = ((-0.132, -0.092), (-0.017, -0.046))
    fragments: int = 6


class FragmentOutcome(Outcome):
    """How a fragment's handling ended (failure modes: Kehoe 2014, III-B)."""

    DONE = "the fragment rests in the receptacle"
    NOT_FOUND = "no camera image showed a fragment there"
    OUT_OF_REACH = "no grasp of the fragment lies within the joint limits of an arm"
    GRASP_FAILURE = "the jaws closed and no part of the fragment was between them"
    MULTIPLE_GRASP = "the jaws closed on more than one fragment"
    PICKUP_FAILURE = "the jaws closed on the fragment and lost it while they rose"
    DROPPED_EN_ROUTE = "the fragment fell out of the jaws on its way to the receptacle"
    DROPOFF_FAILURE = "the fragment was let go over the receptacle and came to lie outside"
    STUCK_IN_JAWS = "the fragment clung to the open jaws"
    RECEPTACLE_FULL = "no room was left in the receptacle"
    BLOCKED = "the other arm was in the way and did not move off"
    ARM_STOPPED = "an arm did not reach the end of a motion"
    CAMERA_FROZEN = "the camera gave no new image"
    OUT_OF_TIME = "the trial's time was over"
    NOT_CLEARED = "the fragment was not in the receptacle at the end"
