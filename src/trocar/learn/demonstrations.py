"""What a study of demonstrations keeps of a trial."""

from __future__ import annotations

from dataclasses import dataclass

from trocar.eval.study import RowKind
from trocar.eval.trial import Trial
from trocar.learn.episode import succeeded


@dataclass(frozen=True)
class Demonstration:
    """One trial: of which run and session, whether it reached all its goals, and how long it took."""

    fingerprint: str
    session: int
    success: bool
    duration_s: float


def _row(trial: Trial) -> Demonstration:
    return Demonstration(trial.about["fingerprint"], trial.about["session"], succeeded(trial), trial.duration_s)


KIND = RowKind(Demonstration, _row)
"""How a trial is reduced."""
