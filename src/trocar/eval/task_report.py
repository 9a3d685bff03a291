"""A task's own part of a report: pictures, tables, comparison with the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Outcome
from trocar.replay import Viewpoint

if TYPE_CHECKING:
    from rich.table import Table

    from trocar.eval.trial import Trial


@dataclass(frozen=True)
class PaperRow:
    """One condition of a published table.

    Attributes:
        who: name of the condition.
        mean_time_s: mean time of one goal; None where it was not published.
        succeeded: number of successes.
        attempted: number of attempts.
        methods: names of our methods that correspond to this condition.
    """

    who: str
    mean_time_s: float | None
    succeeded: int
    attempted: int
    methods: tuple[str, ...] = ()


@dataclass(frozen=True)
class PaperCount:
    """Our results counted as in a paper, where it counts differently.

    Attributes:
        how: how the paper counts, in words.
        succeeded: number of successes.
        attempted: number of attempts.
        ci95: 95 % interval of the rate over sessions.
    """

    how: str
    succeeded: int
    attempted: int
    ci95: tuple[float, float]


class TaskReport:
    """What a task adds to the report of its trials. The base class adds nothing; a task overrides what it needs."""

    view: Viewpoint | None = None
    """Viewpoint of a trial's pictures; None: from the front and above."""

    colours: Mapping[str, tuple[float, float, float]] = {}
    """Colours in pictures for people, where a sensor sees others; an argument of ``trocar.replay.painted``."""

    parts: tuple[str, ...] = ("capture", "perception", "planning", "motion", "jaw", "settling")
    """Names of spans that make up the time of a goal, in the order of the tables; the rest is ``other``."""

    outcomes: type[Outcome] | None = None
    """The task's outcomes, whose sentences explain its failures on the page; None: only their names are shown."""

    captions: Mapping[str, str] = {}
    """Captions of the task's own pictures, by the beginning of the file's name."""

    def frame(self, trial: Trial) -> NDArray[np.float64] | None:
        """Return points (n, 3) in the world that fill a picture's frame; None: the paths of the tips."""
        del trial
        return None

    def goal(self, score: Mapping[str, Any]) -> str:
        """Return a description of a goal besides its number: ``peg 1 to 7``; empty if there is none."""
        del score
        return ""

    def measured(self, score: Mapping[str, Any]) -> Mapping[str, float | None]:
        """Return the measurements of one goal, by name and unit, for the table of goals."""
        del score
        return {}

    def failed_s(self, trial: Trial, score: Mapping[str, Any]) -> float:
        """Return the time of the picture that shows how a goal failed; by default its end."""
        del trial
        return float(score["end_s"])

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return (caption, time in s) of the moments of a trial to show as pictures: by default every goal's end."""
        how = [in_words(s["failure"]) or "done" for s in trial.scores]
        ends = [(f"{trial.goal_noun} {k + 1}: {how[k]}", float(s["end_s"])) for k, s in enumerate(trial.scores)]
        return [("start", 0.0), *ends, ("end", trial.duration_s)]

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw the task's own pictures into a folder and return their paths."""
        del folder, trials
        return []

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return additional keys for the summary of a run."""
        del trials
        return {}

    def paper_rows(self, summary: Mapping[str, Any]) -> Sequence[PaperRow]:
        """Return published rows to compare a run with."""
        del summary
        return ()

    def paper_count(self, summary: Mapping[str, Any]) -> PaperCount | None:
        """Return the run counted as in the paper; None if the paper counts as we do."""
        del summary
        return None

    def tables(self, summary: Mapping[str, Any]) -> list[Table]:
        """Return the task's own tables, to be printed."""
        del summary
        return []

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return sentences that a reader of the figures must know."""
        del trials
        return []


def in_words(name: str) -> str:
    """Return an outcome's name in readable form: ``NOT_GRASPED`` is "not grasped"."""
    return name.lower().replace("_", " ")
