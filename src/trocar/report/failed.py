"""Goals that were not reached in a run, and a picture of each from its saved trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, groupby, zip_longest
from pathlib import Path

from trocar.eval import TaskReport, in_words
from trocar.eval.trial import Trial
from trocar.report.goals import reason_of
from trocar.report.picture import Picture, write_png
from trocar.report.stills import photographer_of

MOST = 12
"""Maximum number of failed goals with a picture; the page says how many more there are."""
SCALE = 0.75
"""Scale of a picture, relative to a width of 640 pixels."""


@dataclass(frozen=True)
class Failed:
    """One goal that was not reached.

    Attributes:
        place: index of its trial among the run's.
        session: of its trial.
        trial: number of its trial in the session.
        number: of the goal, from 0 on.
        failure: its name.
        what: the goal in words.
        reason: in a sentence; empty if there is none.
        stem: of its picture's file.
    """

    place: int
    session: int
    trial: int
    number: int
    failure: str
    what: str
    reason: str
    stem: str


def failed_goals(trials: Sequence[Trial], report: TaskReport) -> list[Failed]:
    """Return all goals that were attempted and not reached, in order."""
    found = []
    for place, trial in enumerate(trials):
        for number, score in enumerate(trial.scores):
            if score["attempted"] and not score["succeeded"]:
                which = report.goal(score)
                session, index = trial.about["session"], trial.about["index"]
                found.append(
                    Failed(
                        place,
                        session,
                        index,
                        number,
                        str(score["failure"]),
                        f"{trial.goal_noun} {number + 1}" + (f" ({which})" if which else ""),
                        reason_of(score, report),
                        f"session_{session:02d}_trial_{index:03d}_goal_{number + 1:02d}",
                    )
                )
    return found


def picked(failed: Sequence[Failed], most: int) -> list[Failed]:
    """Return those that get a picture, in order: the first of each kind of failure, then the second, and so on."""
    by_name = groupby(sorted(failed, key=lambda one: one.failure), key=lambda one: one.failure)
    in_turn = chain.from_iterable(zip_longest(*(list(group) for _, group in by_name)))
    chosen = [one for one in in_turn if one is not None][:most]
    return sorted(chosen, key=lambda one: (one.place, one.number))


def draw_failed(
    folder: str | Path, trials: Sequence[Trial], failed: Sequence[Failed], report: TaskReport
) -> list[Picture]:
    """Draw a picture of each failed goal at the moment that shows its failure, and return them.

    Args:
        folder: for the files.
        trials: of the run.
        failed: of these, in order; each trial is read once.
        report: of the task.
    """
    found = []
    for place, of_trial in groupby(failed, key=lambda one: one.place):
        trial = trials[place]
        photographer = photographer_of(trial, report, SCALE)
        for one in of_trial:
            time_s = report.failed_s(trial, trial.scores[one.number])
            path = write_png(Path(folder) / f"{one.stem}.png", photographer.picture(time_s))
            where = f"session {one.session}, trial {one.trial}, {one.what}: {in_words(one.failure)}"
            why = f". {one.reason[:1].upper()}{one.reason[1:]}" if one.reason else ""
            found.append(Picture(path, f"The cell at {time_s:.1f} s: {where}", f"{where}, at {time_s:.1f} s{why}"))
    return found
