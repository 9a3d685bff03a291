"""Trials as units of work for any process: each unit saves its trial, or skips it if it already exists."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from trocar.counting import Tick, untold
from trocar.errors import BadFile, TrocarError, UnknownName
from trocar.eval.config import RunConfig
from trocar.eval.folder import RECORD, is_done, load_trials, open_folder, set_aside
from trocar.eval.prepare import Prepared, prepare
from trocar.eval.run import Attendant, run_trial
from trocar.eval.staged import AGENT_ERROR
from trocar.eval.study import Condition, RowKind
from trocar.eval.task import TASKS
from trocar.eval.trial import trial_file
from trocar.eval.trials import Trials
from trocar.eval.workers import Workers, pick_workers, run_all
from trocar.sim.laboratory import Listener
from trocar.sim.world import PhysicsError


@dataclass(frozen=True)
class SessionOrder:
    """One session, by its number, of one or more runs (each with its folder), whose cables are to be calibrated.

    Runs that need the same model of an arm find it in the cache.
    """

    runs: Sequence[tuple[RunConfig, Path]]
    session: int


@dataclass(frozen=True)
class TrialOrder:
    """One trial of a run: the run and its folder, the number of the session, and that of the trial in it."""

    config: RunConfig
    folder: Path
    session: int
    index: int

    @property
    def path(self) -> Path:
        """Return the path of the trial's file."""
        return trial_file(self.folder, self.session, self.index)


def calibrate(order: SessionOrder) -> None:
    """Fit the cable models of a session, each once, and save them in every run's folder."""
    for config, folder in order.runs:
        _require_folder(folder)
        if config.chosen_method.calibrated:
            prepare(config, order.session, folder)


def play(
    order: TrialOrder,
    listener: Listener | None = None,
    *,
    raise_errors: bool = False,
    attendant: Attendant | None = None,
) -> str:
    """Run a trial and save it, unless it exists; return a sentence if something is wrong with it, else nothing.

    Args:
        order: the trial.
        listener: called with each event of the scripts.
        raise_errors: whether an exception of the agent is raised; else it ends the trial, which keeps its traceback.
        attendant: a person beside the trial.
    """
    _require_folder(order.folder)
    if is_done(order.folder, (order.session, order.index), order.config.fingerprint):
        return ""
    try:
        prepared, how = _prepared(order), {"raise_errors": raise_errors, "attendant": attendant}
        trial = run_trial(order.config, prepared, order.index, listener, **how)
    except PhysicsError as error:
        return f"{order.path} is void: {error}"
    set_aside(order.path)
    trial.save(order.path)
    gc.collect()  # a world's parts refer to one another, so that a run of ten trials would hold 2 GB
    if trial.ended == AGENT_ERROR:
        return f"{order.path}: {trial.reason}; --raise stops there"
    return ""


_LAST: dict[tuple[str, Path, int], Prepared] = {}
"""The session that this process prepared last; the trials of one session come one after the other."""


def _prepared(order: TrialOrder, listener: Callable[[str, int, int], None] | None = None) -> Prepared:
    key = (order.config.fingerprint, order.folder, order.session)
    if key not in _LAST:
        _LAST.clear()
        _LAST[key] = prepare(order.config, order.session, order.folder, listener=listener)
    return _LAST[key]


def play_run(
    config: RunConfig,
    folder: str | Path,
    todo: Sequence[tuple[int, int]],
    *,
    jobs: int = 1,
    tick: Tick = untold,
    raise_errors: bool = False,
    attendant: Attendant | None = None,
) -> Iterator[str]:
    """Run trials of one run; as they end, yield a sentence for each trial with which something is wrong.

    Args:
        config: the run's configuration.
        folder: the run's folder.
        todo: session and number of each trial.
        jobs: number of trials that run at once; if more than one, each in its own process.
        tick: called with the progress.
        raise_errors: as in :func:`play`; only with one job.
        attendant: a person beside the trials; only with one job.
    """
    folder = Path(folder).absolute()
    orders = [TrialOrder(config, folder, *place) for place in todo]
    if jobs == 1:
        yield from _play_in_turn(config, orders, tick, raise_errors, attendant)
        return
    workers = pick_workers("processes", jobs)
    sessions = [SessionOrder(((config, folder),), session) for session in dict.fromkeys(place[0] for place in todo)]
    tick("setting up sessions", 0, len(sessions))
    for done, _ in enumerate(run_all(calibrate, sessions, workers), start=1):
        tick("setting up sessions", done, len(sessions))
    tick("running trials", 0, len(orders))
    for done, (_, wrong) in enumerate(run_all(play, orders, workers), start=1):
        tick("running trials", done, len(orders))
        yield from [wrong] if wrong else []


def _play_in_turn(
    config: RunConfig,
    orders: Sequence[TrialOrder],
    tick: Tick,
    raise_errors: bool,
    attendant: Attendant | None,
) -> Iterator[str]:
    """Run trials in this process; also report ended goals and rows of a calibration as progress."""
    _LAST.clear()
    goals, noun, done, where = len(config.task.goals()), config.task.goal_noun, 0, ""

    def say(now: str) -> None:
        tick(f"{noun}s", done, goals * len(orders), now)

    def count(arm: str, row: int, total: int) -> None:
        tick(f"{where}: calibration of {arm}", row, total)

    def listen(event: Mapping[str, object]) -> None:
        nonlocal done
        if event["name"] == noun:
            done += 1
            say(f"{where}: a {noun} has ended")

    for number, order in enumerate(orders):
        where = f"session {order.session + 1} of {config.sessions}"
        say(f"{where}: setting up")
        _prepared(order, count)
        where = f"session {order.session + 1}, trial {order.index + 1}"
        say(where)
        wrong = play(order, listen, raise_errors=raise_errors, attendant=attendant)
        done = goals * (number + 1)
        say(f"{where}: saved")
        yield from [wrong] if wrong else []


def _require_folder(folder: Path) -> None:
    """Raise BadFile unless this worker, which may be on another machine, sees the run's folder."""
    if not (folder / RECORD).is_file():
        remedy = "give --out a folder on a file system that all workers see, under the same path"
        raise BadFile(folder / RECORD, "is not found by a worker", remedy)


def opened(conditions: Sequence[Condition]) -> tuple[list[SessionOrder], list[TrialOrder]]:
    """Make or resume the folders of all conditions; return the sessions to calibrate and the trials to run, in order.

    Trials are in the order of sessions, so that an interrupted study has whole sessions of all conditions.
    """
    runs = {one.folder: (one.config, one.folder) for one in conditions}
    todo = [TrialOrder(*run, *place) for run in runs.values() for place in open_folder(*run)]
    todo.sort(key=lambda order: order.session)
    missing: dict[int, dict[Path, tuple[RunConfig, Path]]] = {}
    for order in todo:
        missing.setdefault(order.session, {})[order.folder] = runs[order.folder]
    return [SessionOrder(tuple(found.values()), session) for session, found in missing.items()], todo


def run_study(conditions: Sequence[Condition], kind: RowKind[Any], workers: Workers, tick: Tick) -> list[str]:
    """Run the missing trials of a study and make their rows; return a sentence for each trial with a problem."""
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
    """Run a trial, unless it exists, and save its row; return a sentence if something is wrong, else nothing."""
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
        jobs: number of trials that run at once; if more than one, each in its own process.
        settings: the method's settings that differ from their defaults, by name.
        options: options of the task and of the run (:class:`trocar.eval.config.RunConfig`).

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
    for wrong in play_run(config, folder, open_folder(config, folder), jobs=jobs):
        warnings.warn(wrong, stacklevel=2)
    return load_trials(folder)[0]
