"""What a report shows that is a task's own: pictures, tables, figures of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.replay import Viewpoint

if TYPE_CHECKING:
    from rich.table import Table

    from trocar.trials.trial import Trial


@dataclass(frozen=True)
class PaperRow:
    """One condition of a published table.

    Attributes:
        who: the condition.
        mean_time_s: of one piece; None where it was not published.
        succeeded: pieces.
        attempted: pieces.
    """

    who: str
    mean_time_s: float | None
    succeeded: int
    attempted: int


class TaskReport:
    """What a task adds to the report of its trials. By itself it adds nothing; a task overrides what it has."""

    view: Viewpoint | None = None
    """Where the storyboard's pictures are taken from; None: from the front, so that all that moves is in it."""

    colours: Mapping[str, tuple[float, float, float]] = {}
    """Colours of bodies in pictures for people, by the beginning of their names; where a sensor sees them otherwise."""

    parts: tuple[str, ...] = ("capture", "perception", "planning", "motion", "jaw", "settling")
    """Spans that the time of a piece is made of, in the order of the tables; what is left is ``other``."""

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return (caption, time in s) of what is worth a picture in a trial: by default the end of every goal."""
        how = [str(s["failure"]).lower().replace("_", " ") or "done" for s in trial.scores]
        ends = [(f"{trial.piece} {k + 1}: {how[k]}", float(s["end_s"])) for k, s in enumerate(trial.scores)]
        return [("start", 0.0), *ends, ("end", trial.duration_s)]

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw pictures of the task's own into a folder and return their paths."""
        del folder, trials
        return []

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return keys that the summary of a run gets besides the usual ones."""
        del trials
        return {}

    def paper_rows(self, summary: Mapping[str, Any]) -> Sequence[PaperRow]:
        """Return published rows that a run can be read beside."""
        del summary
        return ()

    def tables(self, summary: Mapping[str, Any]) -> list[Table]:
        """Return tables of the task's own, to be printed."""
        del summary
        return []

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return sentences that a reader of the figures must know."""
        del trials
        return []
