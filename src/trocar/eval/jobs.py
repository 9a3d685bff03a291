"""Trials as units of work that any process can do: each saves its trial, and skips one that already exists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar.errors import BadFile
from trocar.eval.config import RunConfig
from trocar.eval.folder import RECORD, is_done, set_aside
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.run import free_memory, run_trial
from trocar.eval.trial import trial_file
from trocar.sim.world import PhysicsError


@dataclass(frozen=True)
class SessionOrder:
    """One session of one or more runs whose cables are to be calibrated.

    Attributes:
        runs: each with its folder; those that need the same model of an arm find it in the cache.
        session: its number.
    """

    runs: Sequence[tuple[RunConfig, Path]]
    session: int


@dataclass(frozen=True)
class TrialOrder:
    """One trial of a run.

    Attributes:
        config: of the run.
        folder: of the run.
        session: number.
        index: of the trial in its session.
    """

    config: RunConfig
    folder: Path
    session: int
    index: int

    @property
    def path(self) -> Path:
        """Return the path of the trial's file."""
        return trial_file(self.folder, self.session, self.index)


def calibrate(order: SessionOrder) -> None:
    """Fit the cable models of a session, each once, and store them in every run's folder."""
    for config, folder in order.runs:
        _require_folder(folder)
        if config.chosen_method.calibrated:
            prepare(config, order.session, folder)


def play(order: TrialOrder) -> str:
    """Run a trial and save it, unless it exists; return why it is void, empty if it is valid."""
    _require_folder(order.folder)
    if is_done(order.folder, (order.session, order.index), order.config.fingerprint):
        return ""
    try:
        trial = run_trial(order.config, _prepared(order), order.index)
        set_aside(order.path)
        trial.save(order.path)
        free_memory()
    except PhysicsError as error:
        return f"{order.path} is void: {error}"
    return ""


_LAST: dict[tuple[str, Path, int], Prepared] = {}
"""The session that this process prepared last, since its trials are handed out one after the other."""


def _prepared(order: TrialOrder) -> Prepared:
    key = (order.config.fingerprint, order.folder, order.session)
    if key not in _LAST:
        _LAST.clear()
        _LAST[key] = prepare(order.config, order.session, order.folder)
    return _LAST[key]


def _require_folder(folder: Path) -> None:
    """Raise unless a worker, which may be on another machine, sees the run's folder."""
    if not (folder / RECORD).is_file():
        raise BadFile(
            folder / RECORD,
            "is not found by a worker",
            "give --out a folder on a file system that all workers see, under the same path",
        )
