"""``trocar run TASK``, ``trocar study TASK``, ``trocar sweep FILE``: trials of tasks in the simulated cell."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from trocar.cli.console import (
    ABOUT_CONFIRM,
    ABOUT_DEVICES,
    ABOUT_SPEED,
    NOTHING,
    is_policy,
    opened_console,
    refuse_speed,
)
from trocar.cli.group import Known, Result
from trocar.cli.options import EnableMotion, JsonFlag, Plugins, Seed, Yes, need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.report import finish
from trocar.cli.robot import refuse_motion_flags, run_robot
from trocar.cli.task_group import OF_RUN, TaskGroup
from trocar.cli.terminal import beside, rich_table
from trocar.counting import counted
from trocar.errors import BadFile, EmergencyStop, InvalidInput
from trocar.eval import METHODS, TASKS, Task, methods_of_any
from trocar.eval.config import RunConfig
from trocar.interruption import CtrlC

if TYPE_CHECKING:
    from trocar.eval.study import Condition, Results, RowKind, TableData

OF_STUDY = ("trials", "model", "station", "difficulty", "flaws")

CacheFolder = Annotated[
    Path | None,
    Option(
        metavar="DIR",
        envvar="TROCAR_CACHE",
        help="Folder where fitted cable models are kept for other runs.",
        show_default="~/.cache/trocar",
    ),
]
ABOUT_RAISE = "Stop at an exception of the agent, which otherwise ends only its trial."
ABOUT_WATCH = "Open a page on which a person watches, stops, takes over; with --method person, does it all."
ABOUT_POLICY = "With --method policy: a folder, FILE.py:function, module:function or tcp://HOST:PORT."
Jobs = Annotated[int | None, Option(min=1, help="How many trials to run at once.", show_default="one per core")]
Backend = Annotated[str, Option(help="Where the work is done: processes, dask.")]
Scheduler = Annotated[
    str, Option(metavar="ADDRESS", help="Address of a dask cluster.", show_default="a cluster on this machine")
]
ReportOnly = Annotated[bool, Option("--report-only", help="Run nothing; report on what is there.")]


def run(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    run: Mapping[str, Any],
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for the files; default out/TASK-METHOD-SEED-OPTIONS.")
    ] = None,
    jobs: Annotated[int, Option(min=1, help="How many trials to run at once, each in its own process.")] = 1,
    strict: Annotated[bool, Option("--strict", help="Exit with code 1 if a goal was missed.")] = False,
    raise_errors: Annotated[bool, Option("--raise", help=ABOUT_RAISE)] = False,
    cache: CacheFolder = None,
    enable_motion: EnableMotion = False,
    yes: Yes = False,
    policy: Annotated[str, Option(metavar="WHAT", help=ABOUT_POLICY)] = "",
    watch: Annotated[bool, Option("--watch", help=ABOUT_WATCH)] = False,
    confirm: Annotated[str, Option(metavar="motions|goals|nothing", help=f"With --watch. {ABOUT_CONFIRM}")] = NOTHING,
    speed: Annotated[float, Option(help=f"With --watch. {ABOUT_SPEED}")] = 1.0,
    devices: Annotated[
        int | None, Option(metavar="PORT", min=0, max=65535, help=f"With --watch. {ABOUT_DEVICES}")
    ] = None,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    need("sim")
    from trocar.eval.folder import open_folder
    from trocar.eval.jobs import play_run  # the simulator is heavy
    from trocar.eval.prepare import CACHE

    if cache is not None:
        os.environ[CACHE] = str(cache)  # for this process and its children
    if raise_errors and jobs != 1:
        raise InvalidInput("--raise", "has no effect on trials in other processes", "drop --jobs")
    config = RunConfig(task(**options), **_with_policy(run, policy), plugins=tuple(map(str, plugin or ())))
    _require_console(config, watch, confirm, speed, devices, jobs)
    console = opened_console(confirm, speed, devices) if watch else nullcontext()
    if config.robot:
        if jobs != 1:
            raise InvalidInput(f"--jobs {jobs}", "is more than one robot can do at once", "drop --jobs")
        with console as attendant:
            how = {"attendant": attendant, "strict": strict, "as_json": as_json}
            run_robot(config, out, enable_motion=enable_motion, yes=yes, **how)
        return
    refuse_motion_flags(enable_motion=enable_motion, yes=yes)
    if config.model == "lstm":
        need("learn")
    folder = out or default_folder(f"{task.name}-{config.method}-{config.seed}", config.unusual)
    interrupted = False
    try:
        with console as attendant, progress() as tick, CtrlC() as ctrl_c:
            todo = open_folder(config, folder)
            if not todo:
                kept = counted(config.sessions * config.trials, "trial")
                beside().print(f"nothing to run: {folder} has the run's {kept}", soft_wrap=True)

            def shown(work: str, done: int, total: int | None, now: str = "") -> None:
                ctrl_c.check()
                tick(work, done, total, now)

            how = {"jobs": jobs, "tick": shown, "raise_errors": raise_errors, "attendant": attendant}
            for wrong in play_run(config, folder, todo, **how):
                beside().print(wrong, soft_wrap=True)
    except (KeyboardInterrupt, EmergencyStop) as stop:
        interrupted = True
        if str(stop):
            beside().print(str(stop), soft_wrap=True)
    all_succeeded = finish(folder, as_json, interrupted)
    if interrupted or (strict and not all_succeeded):
        raise typer.Exit(130 if interrupted else 1)


def _require_console(
    config: RunConfig, watch: bool, confirm: str, speed: float, devices: int | None, jobs: int
) -> None:
    """Raise if options need a console that is not open, or do not fit the console of this run."""
    if watch:
        refuse_speed(config, speed)
    if watch and jobs != 1:
        raise InvalidInput(f"--jobs {jobs}", "is more trials than one person can watch", "drop --jobs")
    if watch and confirm != NOTHING and is_policy(config.chosen_method):
        raise InvalidInput(f"--confirm {confirm}", "is for motions, and a policy streams its steps", "drop it")
    if watch:
        return
    if confirm != NOTHING or speed != 1.0 or devices is not None:
        raise InvalidInput("--confirm, --speed and --devices", "need a console", "give --watch, or drop them")
    if config.chosen_method.attended:
        raise InvalidInput(f"--method {config.method}", "is a person, who needs a console", "give --watch")


def _with_policy(run: Mapping[str, Any], policy: str) -> dict[str, Any]:
    """Return a run's options with those of its policy, which is loaded once before anything is written."""
    asked = run["method"] in methods_of_any() and is_policy(METHODS[f"*/{run['method']}"])
    if asked and not policy:
        raise InvalidInput(f"--method {run['method']}", "names no policy", "give --policy DIR, or module:function")
    if not policy:
        return dict(run)
    if not asked:
        remedy = "give --method policy or policy-calibrated"
        raise InvalidInput(f"--policy {policy}", "is used by another method than the one chosen", remedy)
    from trocar.learn.policy import load_policy, policy_digest

    given = METHODS[f"*/{run['method']}"].make_settings(run["settings"])
    with load_policy(policy, timeout_s=given.timeout_s):
        settings = f"policy={policy}", f"policy_digest={policy_digest(policy)}"
    return {**run, "settings": (*settings, *run["settings"])}


class _Runs(TaskGroup):
    body = staticmethod(run)
    kind = "task"
    does = "Runs trials in the simulated cell, scores them, and keeps files and pictures."
    example = "trocar run {task} --trials 2 --seed 1 --out out/two"
    of_run = tuple(OF_RUN)


RUN = _Runs(
    "run",
    "Run trials of a task in the simulated cell, score them, and keep files and pictures.",
    {},
    epilog="Example: trocar run peg-transfer --sessions 10 --trials 1 --seed 1 --out out/ten",
)


def study(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    run: Mapping[str, Any],
    methods: Annotated[str, Option(metavar="A,B,...", show_default="all", help="Which methods.")] = "",
    sessions: Annotated[int, Option(help="How many days are drawn, the same for all conditions.")] = 10,
    seed: Seed = 0,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for the files; default out/STUDY-SEED-OPTIONS.")
    ] = None,
    jobs: Jobs = None,
    backend: Backend = "processes",
    scheduler: Scheduler = "",
    report_only: ReportOnly = False,
    plugin: Plugins = None,
) -> Result:
    """Run every method in the same sessions, compare them, and set the paper's figures beside them."""
    need("sim")
    from trocar.eval.study import conditions_of, study_of  # the simulator is heavy
    from trocar.report.study import write_study

    of_task = study_of(task)
    own = {name: value for name, value in options.items() if name != of_task.varied}
    unusual = {
        OF_RUN[name].metadata["flag"] or name: run[name]
        for name in ("model", "station", "difficulty", "flaws")
        if run[name] != OF_RUN[name].default
    }
    unusual |= {"plugin": plugin} if plugin else {}
    folder = out or default_folder(f"study-{task.name}-{seed}", unusual | differing(task, own))
    plugins = tuple(map(str, plugin or ()))
    values = options[of_task.varied]
    conditions = conditions_of(
        task, folder, values=values, methods=methods, options=own, sessions=sessions, seed=seed, plugins=plugins, **run
    )
    results, missing = worked(folder, conditions, of_task.kind, report_only, jobs, backend, scheduler)
    summary, tables, notes, files = write_study(folder, task.name, of_task, results, missing)
    return _printed(summary, tables, notes, files)


class _Studies(TaskGroup):
    body = staticmethod(study)
    kind = "study"
    does = "Runs every method in the same sessions, compares them, and sets the paper's figures beside them."
    example = "trocar study {task} --sessions 10 --seed 1 --out out/study"
    of_run = OF_STUDY

    def tasks(self) -> list[str]:
        """Return the names of the tasks that have a study."""
        return [name for name in TASKS if TASKS[name].study is not None]

    def varied(self, task: type[Task]) -> str:
        """Return the option that takes several values."""
        from trocar.eval.study import study_of  # the report of the task is heavy

        return study_of(task).varied


STUDY = _Studies(
    "study",
    "Reproduce a paper's table beside the paper's own figures.",
    {
        "calibration": Known(
            "Print Table I of the paper and the errors of all cable models, from recordings of real arms.",
            "trocar.cli.study_calibration:calibration",
            "trocar study calibration --data data --out study --no-lstm",
        ),
        "demonstrations": Known(
            "Let a method do a task in new sessions, on all cores: a LeRobot data set of it.",
            "trocar.cli.learn:DEMONSTRATIONS",
        ),
    },
)


def sweep(
    file: Annotated[Path, Argument(metavar="FILE", help="TOML: task, methods, seeds, flaws with their sizes.")],
    *,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder for the files; default out/FILE.")] = None,
    jobs: Jobs = None,
    backend: Backend = "processes",
    scheduler: Scheduler = "",
    report_only: ReportOnly = False,
    plugin: Plugins = None,
) -> Result:
    """Run methods against flaws of several sizes, in the sessions of several seeds: one table and one picture.

    Each size of each flaw is an ordinary run in a folder of the sweep's, and so is the laboratory as it is; all meet
    the same sessions. Trials are kept as they end; the same command continues where it stopped.
    """
    need("sim")
    from trocar.report.sweep import KIND, Sweep, conditions_of, figures_of, tables_of, write_sweep

    found = Sweep.read(file)
    folder = out or Path("out") / file.stem
    points = found.points(folder, list(map(str, plugin or ())))
    results, missing = worked(folder, conditions_of(points), KIND, report_only, jobs, backend, scheduler)
    rows = {one.condition.folder: one.rows for one in results}
    figures = [figure for point in points if (figure := figures_of(point, rows)) is not None]
    summary, files = write_sweep(folder, found.task.name, figures, missing)
    return _printed(summary, tables_of(figures), summary["notes"], files)


def worked(
    folder: Path,
    conditions: Sequence[Condition],
    kind: RowKind[Any],
    report_only: bool,
    jobs: int | None,
    backend: str,
    scheduler: str,
) -> tuple[list[Results[Any]], list[str]]:
    """Run the missing trials, with a progress bar; return the results and a sentence for each missing trial."""
    from trocar.eval.jobs import run_study  # the simulator is heavy
    from trocar.eval.study import read_study
    from trocar.eval.workers import pick_workers

    workers = pick_workers(backend, jobs or os.cpu_count() or 1, scheduler)
    if folder.exists() and not folder.is_dir():
        raise BadFile(folder, "is a file", "give a folder", kind="--out")
    if report_only and not any(folder.glob("*/run.json")):
        there = "holds no study" if folder.is_dir() else "does not exist"
        raise BadFile(folder, there, "give that of a study with --out, or drop --report-only", kind="folder")
    try:
        with progress() as tick:
            void = [] if report_only else run_study(conditions, kind, workers, tick)
            results, missing = read_study(conditions, kind, tick)
    except KeyboardInterrupt:
        beside().print("stopped; finished trials are kept; run the same command to continue")
        raise typer.Exit(130) from None
    return results, [*void, *missing]


def _printed(
    summary: Mapping[str, Any], tables: Sequence[TableData], notes: Sequence[str], files: Sequence[Path]
) -> Result:
    shown = []
    for table in tables:
        columns = [k for k, name in enumerate(table.head) if name not in table.page_only]
        rows = [[row[k] for k in columns] for row in table.rows]
        shown.append(rich_table(table.title, [table.head[k] for k in columns], rows, table.caption))
    return Result(summary, ["files: " + ", ".join(map(str, files))], [*shown, *notes])
