"""Trials as units of work that any process can do: each saves its trial, and skips one that already exists."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from trocar.errors import BadFile, TrocarError, UnknownName
from trocar.eval.config import RunConfig
from trocar.eval.folder import RECORD, is_done, load_trials, open_folder, set_aside
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.run import free_memory, run_trial
from trocar.eval.study import Condition, RowKind, Tick
from trocar.eval.task import TASKS
from trocar.eval.trial import trial_file
from trocar.eval.trials import Trials
from trocar.eval.workers import Workers, pick_workers, run_all
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


def opened(conditions: Sequence[Condition]) -> tuple[list[SessionOrder], list[TrialOrder]]:
    """Make or resume the folders of all conditions; return the sessions to calibrate and the trials to run, in order.

    Trials come session by session, so that an interrupted study has whole sessions of all conditions.
    """
    runs = {one.folder: (one.config, one.folder) for one in conditions}
    todo = [TrialOrder(*run, *place) for run in runs.values() for place in open_folder(*run)]
    todo.sort(key=lambda order: order.session)
    missing: dict[int, dict[Path, tuple[RunConfig, Path]]] = {}
    for order in todo:
        missing.setdefault(order.session, {})[order.folder] = runs[order.folder]
    return [SessionOrder(tuple(found.values()), session) for session, found in missing.items()], todo


def run_study(conditions: Sequence[Condition], kind: RowKind[Any], workers: Workers, tick: Tick) -> list[str]:
    """Run the missing trials of a study, and make their rows; return a sentence for each trial that is void."""
    sessions, todo = opened(conditions)
    wanted = sum(len(one.places) for one in conditions)
    calibrated = [order for order in sessions if any(config.chosen_method.calibrated for config, _ in order.runs)]
    for done, _ in enumerate(run_all(calibrate, calibrated, workers), start=1):
        tick("calibrating sessions", done, len(calibrated))
    there = wanted - len(todo)
    tick("running trials", there, wanted)
    void = []
    for done, (_, sentence) in enumerate(run_all(partial(_play_and_reduce, kind), todo, workers), start=1):
        tick("running trials", there + done, wanted)
        void += [sentence] if sentence else []
    return void


def _play_and_reduce(kind: RowKind[Any], order: TrialOrder) -> str:
    """Run a trial, unless it exists, and store its row; return why it is void, empty if it is valid."""
    void = play(order)
    if not void:
        try:
            kind.read(order.path, order.config.fingerprint)
        except TrocarError as error:  # the trial is saved; the report says what is wrong with it
            return str(error)
    return void


def run(
    task: str,
    *,
    out: str | Path | None = None,
    jobs: int = 1,
    settings: Mapping[str, object] | None = None,
    **options: Any,
) -> Trials:
    """Run trials of a task in the simulated cell and return them; finished ones are kept and not run again.

    Args:
        task: name of the task.
        out: folder for the files; None: ``out/TASK-METHOD-SEED-DIGEST``.
        jobs: how many trials are run at once, each in its own process.
        settings: those of the method that differ from their defaults, by name.
        options: of the task, and of the run (:class:`trocar.eval.config.RunConfig`).

    Raises:
        UnknownName: there is no such task or option.
        InvalidInput: the run is not possible.
    """
    kind = TASKS.pick(task)
    own = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    of_run = {field.name for field in fields(RunConfig) if field.init} - {"task", "settings"}
    for name in options:
        if name not in own | of_run:
            raise UnknownName("option", name, sorted(own | of_run))
    given = {name: value for name, value in options.items() if name in of_run}
    changes = tuple(f"{name}={value}" for name, value in (settings or {}).items())
    config = RunConfig(kind(**{n: v for n, v in options.items() if n in own}), settings=changes, **given)
    usual = Path("out") / f"{task}-{config.method}-{config.seed}-{config.fingerprint[:8]}"
    folder = Path(out or usual).absolute()
    orders = [TrialOrder(config, folder, *place) for place in open_folder(config, folder)]
    if jobs == 1:
        ended = map(play, orders)
    else:
        workers = pick_workers("processes", jobs)
        days = dict.fromkeys(order.session for order in orders)
        for _ in run_all(calibrate, [SessionOrder(((config, folder),), day) for day in days], workers):
            pass
        ended = (void for _, void in run_all(play, orders, workers))
    for void in ended:
        if void:
            warnings.warn(void, stacklevel=2)
    return load_trials(folder)[0]
