"""Goals of debridement, and the outcomes of handling a fragment."""

from __future__ import annotations

from typing import NamedTuple

from trocar.cell import Outcome


class Clearing(NamedTuple):
    """One goal: one more fragment is to rest in the receptacle.

    Attributes:
        number: 0 is the first that is cleared, 1 the second, whichever fragments they are.
    """

    number: int


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
