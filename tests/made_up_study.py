"""A made-up study: trials with known outcomes in the folders of its conditions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from synthetic import keep, synthetic_trial
from trocar.eval.jobs import opened
from trocar.eval.study import Condition, conditions_of
from trocar.eval.trial import trial_file
from trocar.tasks.peg_transfer.report.study import KIND
from trocar.tasks.peg_transfer.task import PegTransfer


def saved(folder: Path, sessions: int = 3, trials: int = 1, failures: int = 6) -> list[Condition]:
    """Save a study of one variant, return its conditions; each uncalibrated trial has ``failures`` failed transfers."""
    cells = conditions_of(
        PegTransfer,
        folder,
        values="unilateral",
        methods="calibrated,uncalibrated",
        sessions=sessions,
        trials=trials,
        seed=2,
    )
    opened(cells)
    for cell in cells:
        failed = {k: "DROPPED" for k in range(failures)} if cell.method == "uncalibrated" else {}
        for session, index in cell.places:
            trial = synthetic_trial(cell.config, index, failed, session)
            hits = trial.collisions * 4 if failed else []
            keep(replace(trial, collisions=hits), cell.folder)
    return cells


def rows_of(cell: Condition) -> list:
    return [KIND.read(trial_file(cell.folder, *place), cell.config.fingerprint) for place in cell.places]
