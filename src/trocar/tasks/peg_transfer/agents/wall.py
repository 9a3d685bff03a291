"""How far jaws stay open on a block's wall, learned from closings: it tells thin walls from edges of walls."""

from __future__ import annotations

from trocar.tasks.peg_transfer.agents import Settings

JAW_SLACK_RAD = 0.01
"""Jaws that stall this close to ``release_rad`` were blocked by something other than a wall. Of 560 closings in ten
sessions, the thickest walls stopped the jaws at 0.295 rad."""
NOTHING_RAD = 0.08
"""Jaws that close further than this are empty: the thinnest of 5000 drawn walls would hold them open by 0.13."""
MAX_THINNER_RAD = 0.06
"""Jaws that close this much further than usual hold the edge of a wall, or only its rim. Of 789 closings, 98 % were
within 0.04 of what was usual in their session; of the five further than 0.06, four had the block by its top edge."""


class WallOpening:
    """The jaws' opening on a wall. All blocks of a board are printed alike, so closings tell what is usual.

    Attributes:
        most_rad: jaws that stall further open were stopped by something else.
    """

    def __init__(self, settings: Settings):
        self._least_rad, self.most_rad = settings.jaw_empty_rad, settings.release_rad - JAW_SLACK_RAD
        self._stalls_rad: list[float] = []

    @property
    def least_rad(self) -> float:
        """Return the opening above which jaws hold a whole wall.

        As long as nothing is known, that is ``jaw_empty_rad``. A first closing below it may be at the edge of a wall;
        after a second one, walls are known to be thin. What is usual is the upper quartile of the closings, as what
        goes wrong lets jaws close further.
        """
        count = len(self._stalls_rad)
        usual_rad = sorted(self._stalls_rad)[3 * count // 4] if count else 0.0
        if usual_rad <= self._least_rad and count < 2:
            return self._least_rad
        return max(NOTHING_RAD, usual_rad - MAX_THINNER_RAD)

    def fits(self, jaw_rad: float) -> bool:
        """Return whether jaws that were stopped at this opening hold a whole wall."""
        return self.least_rad < jaw_rad < self.most_rad

    def learn(self, jaw_rad: float) -> None:
        """Learn from a closing on something, whether or not it was a whole wall; empty jaws tell nothing."""
        if NOTHING_RAD < jaw_rad < self.most_rad:
            self._stalls_rad.append(jaw_rad)
