"""What a robustness study needs from a trial of any task."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trocar.eval.rows import kept_row
from trocar.eval.trial import Trial

VERSION = 1
"""Version of rows: a change causes stored ones to be made again."""


@dataclass(frozen=True)
class Row:
    """One trial.

    Attributes:
        fingerprint: of its run.
        session: its number.
        index: of the trial in its session.
        goals: how many there were.
        succeeded: how many of them were reached.
        collisions: how many there were.
        duration_s: on the trial's clock.
    """

    fingerprint: str
    session: int
    index: int
    goals: int
    succeeded: int
    collisions: int
    duration_s: float


def read_row(trial: str | Path, fingerprint: str) -> Row:
    """Return the row of a trial's file; it is made and stored if there is no valid one.

    Raises:
        TrocarError: the trial cannot be read.
    """
    return kept_row(trial, fingerprint, Row, VERSION, _row_of)


def _row_of(trial: Trial) -> Row:
    return Row(
        fingerprint=str(trial.about["fingerprint"]),
        session=int(trial.about["session"]),
        index=int(trial.about["index"]),
        goals=len(trial.scores),
        succeeded=sum(bool(score["succeeded"]) for score in trial.scores),
        collisions=len(trial.collisions),
        duration_s=trial.duration_s,
    )
