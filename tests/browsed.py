"""Made-up runs in a folder, for tests of the pages that show them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from synthetic import config, keep, synthetic_trial
from trocar.eval.folder import open_folder
from trocar.eval.trial import trial_file

Failures = Mapping[tuple[int, int], dict[int, str]]


def made_run(folder: Path, failures: Failures | None = None, places: int = 0, **options: object) -> Path:
    """Make a run's folder and return it.

    Args:
        folder: the run's folder.
        failures: failed goals and their failures, by session and trial.
        places: number of trials to make; 0: all.
        options: fields of ``RunConfig``.
    """
    run, failed = config(**options), failures or {}
    todo = open_folder(run, folder)
    for session, index in todo[: places or len(todo)]:
        keep(synthetic_trial(run, index, failed.get((session, index)), session), folder)
    return folder


def made_runs(folder: Path) -> Path:
    """Make two runs of the same three sessions, one of another seed, and four that are incomplete or damaged."""
    made_run(folder / "day" / "good", {(1, 0): {4: "DROPPED"}}, sessions=3, seed=7)
    bad = {(session, 0): dict.fromkeys(range(3 + session), "NOT_GRASPED") for session in range(3)}
    made_run(folder / "day" / "bad", bad, sessions=3, seed=7, method="uncalibrated")
    made_run(folder / "other", sessions=2, trials=2, seed=8)
    made_run(folder / "unfinished", places=1, sessions=2, seed=9)
    made_run(folder / "begun", seed=10)
    trial_file(folder / "begun", 0, 0).unlink()
    made_run(folder / "torn", sessions=2, seed=11)
    trial_file(folder / "torn", 0, 0).write_bytes(b"not a trial")
    (folder / "lost").mkdir()
    (folder / "lost" / "run.json").write_text("{")
    return folder
