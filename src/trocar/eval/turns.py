"""Which arm worked on which goal, and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

NEARLY_S = 1e-9


@dataclass(frozen=True)
class Turn:
    """A stretch of a trial in which one arm (None: any) worked on one goal, numbered from 0 on."""

    goal: int
    arm: str | None
    start_s: float
    end_s: float

    def holds(self, time_s: float) -> bool:
        """Return whether a time is within it."""
        return self.start_s - NEARLY_S <= time_s < self.end_s - NEARLY_S


def turns_of(trial: Trial) -> list[Turn]:
    """Return the turns of all arms.

    A script notes them in the event that ends a goal, named ``goal_noun``. Its ``turns`` are start and end by arm;
    ``arm`` and ``start_s`` suffice if one arm worked alone. Its ``goal`` is the goal's number among the scores; without
    it, goals are numbered in the order of their ends. If no arms are noted, every goal belongs to all arms, from the
    start to the end of its score.
    """
    found: list[Turn] = []
    ended = (event for event in trial.events if event["name"] == trial.goal_noun)
    for order, event in enumerate(ended):
        alone = {event["arm"]: (event["start_s"], event["time_s"])} if {"arm", "start_s"} <= event.keys() else {}
        goal = int(event.get("goal", order))
        found += [Turn(goal, arm, *map(float, times)) for arm, times in event.get("turns", alone).items()]
    return found or [
        Turn(number, None, float(score["start_s"]), float(score["end_s"])) for number, score in enumerate(trial.scores)
    ]


def turn_at(turns: list[Turn], arm: str, time_s: float) -> Turn | None:
    """Return an arm's turn at a time; None if it has none."""
    return next((turn for turn in turns if turn.arm in (None, arm) and turn.holds(time_s)), None)
