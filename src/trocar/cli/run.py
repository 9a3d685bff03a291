"""``trocar run TASK``, ``trocar study TASK``, ``trocar sweep FILE``: trials of tasks in the simulated cell.

The options of a run are the fields of ``RunConfig``, those of a task its own; both become options of the command here.
"""

from __future__ import annotations

import inspect
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from trocar.cli.group import Deferred, Group, Known, Result, command_of
from trocar.cli.options import JsonFlag, Plugins, Seed, load_given, need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.report import finish
from trocar.cli.terminal import beside, rich_table
from trocar.counting import counted
from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.eval import TASKS, Task, methods_of, methods_of_any, perceptions_of, pick_method
from trocar.eval.config import RunConfig
from trocar.interruption import CtrlC
from trocar.registry import PLUGIN_MODULE

if TYPE_CHECKING:
    from trocar.eval.study import Condition, Results, RowKind, TableData

OWN = "Of this task"
"""Heading of a task's own options."""
CONFIG = "--config"
OF_RUN = {field.name: field for field in fields(RunConfig) if field.metadata}
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
ABOUT_RAISE = "Stop at an exception of the agent, which else ends its trial only."
ABOUT_POLICY = "With --method policy: a folder, FILE.py:function, module:function or tcp://HOST:PORT."
Jobs = Annotated[int | None, Option(min=1, help="How many trials to run at once.", show_default="one per core")]
Backend = Annotated[str, Option(help="Where the work is done: processes, dask.")]
Scheduler = Annotated[
    str, Option(metavar="ADDRESS", help="Address of a dask cluster.", show_default="a cluster on this machine")
]
ReportOnly = Annotated[bool, Option("--report-only", help="Run nothing; report on what is there.")]


class TaskGroup(Group):
    """The tasks as commands. A plugin that is named anywhere on the line is loaded before its task is looked up.

    Attributes:
        body: the function that a task's command calls with the task's class, the values of the task's options, those of
            the run's, and those of its other parameters, which are the command's other options.
        kind: what a member is called where one is unknown.
        does: what its commands do, a sentence.
        example: a line, with ``{task}`` for the task's name and, if it needs one, its plugin.
        of_run: names of those fields of ``RunConfig`` that are options here.
    """

    body: Callable[..., None]
    kind: str
    does: str
    example: str
    of_run: Sequence[str]

    def __init__(self, name: str, about: str, members: Mapping[str, Known], **rest: Any) -> None:
        def loads_plugins(plugin: Plugins = None) -> None:
            del plugin  # loaded when it was parsed

        shared = command_of(name, loads_plugins, "").params
        super().__init__(name, about, members, params=[one for one in shared if one.name == "plugin"], **rest)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the content of ``--config FILE`` before the words of the line, load its plugins, and parse it."""
        args = _expanded(args)
        load_given(args)
        return super().parse_args(ctx, args)

    def tasks(self) -> Sequence[str]:
        """Return the names of the tasks that are commands here."""
        return list(TASKS)

    def varied(self, task: type[Task]) -> str:
        """Return the name of a task's option that takes several values here; empty: none."""
        del task
        return ""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return [*super().list_commands(ctx), *self.tasks()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a placeholder for the command of a task; its options are found when they are needed."""
        if cmd_name in self.tasks():
            task = TASKS[cmd_name]
            return Deferred(cmd_name, f"{_about(task)}.", lambda: self.command(task))
        if cmd_name not in self.list_commands(ctx):
            raise UnknownName(self.kind, cmd_name, self.list_commands(ctx))
        return super().get_command(ctx, cmd_name)

    def command(self, task: type[Task]) -> Any:
        """Return the command of one task: the options of its runs, those of the group's ``body``, and its own."""
        hints = inspect.get_annotations(RunConfig, eval_str=True)
        known = {"method": (*methods_of(task), *methods_of_any()), "perception": perceptions_of(task)}
        parameters = [_parameter(OF_RUN[name], hints[name], choices=known.get(name, ())) for name in self.of_run]
        of_body = inspect.signature(self.body, eval_str=True).parameters.values()
        parameters += [one for one in of_body if one.name not in ("task", "options", "run")]
        own, varied = {field.name: field for field in fields(task)}, self.varied(task)  # type: ignore[arg-type]
        for one in parameters:
            if one.name in own:
                problem = "is already an option of every run"
                raise InvalidInput(f"option {one.name!r} of task {task.name!r}", problem, "give it another name")
        classes = (kind for kind in reversed(task.__mro__) if kind not in (Task, object))
        hints = {k: v for kind in classes for k, v in inspect.get_annotations(kind, eval_str=True).items()}
        for name, field in own.items():
            choices = field.metadata.get("choices", ())
            parameters.append(_parameter(field, hints[name], OWN, choices, listed=name == varied))

        def command(**given: Any) -> None:
            options, run = ({name: given.pop(name) for name in names} for names in (own, self.of_run))
            run |= {name: tuple(value or ()) for name, value in run.items() if isinstance(value, list | None)}
            self.body(task=task, options=options, run=run, **given)

        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        methods = "; ".join(f"{name}: {pick_method(task, name).about}" for name in methods_of(task))
        kept = "Interrupted, it keeps its finished trials; the same command continues where it stopped."
        command.__doc__ = f"{_about(task)}.\n\n{self.does} {kept}\n\nMethods: {methods}."
        plugin = " --plugin FILE" if task.__module__.startswith(PLUGIN_MODULE) else ""
        return command_of(task.name, command, self.example.format(task=f"{task.name}{plugin}"))


def _about(task: type[Task]) -> str:
    return f"{task.about[:1].upper()}{task.about[1:]}"


def _parameter(
    field: Field[Any], hint: Any, panel: str = "", choices: Sequence[str] = (), *, listed: bool = False
) -> inspect.Parameter:
    """Return the command line's parameter of a field that ``option`` declares; ``listed``: of several of its values."""
    about, kind = {"help": "", "flag": "", "metavar": "", "shown": "", **field.metadata}, hint
    default = None if field.default is MISSING else field.default
    name, metavar, shown = about["flag"] or field.name, about["metavar"], about["shown"] or default is not None
    help = about["help"] + (f" One of {', '.join(choices)}." if choices else "")
    if hint == tuple[str, ...]:
        kind, default, shown = list[str] | None, None, False
    if listed:
        kind, default, name = str, "", f"{field.name.removesuffix('s')}s"
        help, metavar, shown = about["help"], "A,B,...", "all"
    flag = f"--{name.replace('_', '-')}"
    described = Option(flag, help=help, metavar=metavar or None, rich_help_panel=panel or None, show_default=shown)
    annotation = Annotated[kind, described]
    return inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _expanded(args: Sequence[str]) -> list[str]:
    """Return a line whose ``--config FILE`` is replaced by the file's content, before the words of the line itself."""
    words, first = list(args), []
    while CONFIG in words:
        at = words.index(CONFIG)
        if at + 1 == len(words):
            raise InvalidInput(CONFIG, "names no file", "give a TOML file of options")
        first = _words_of(Path(words[at + 1]))
        del words[at : at + 2]
    return first + words


def _words_of(path: Path) -> list[str]:
    """Return the words of a command line from a TOML file: the task first, then its options by name."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadFile(path, f"is no readable TOML file ({error})", "see examples/run.toml", kind=CONFIG) from None
    words = [str(values.pop("task"))] if "task" in values else []
    for name, value in values.items():
        flag = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, dict):
                raise BadFile(path, f"has a table {name!r}", "give options by name, one a line", kind=CONFIG)
            words += [flag] if one is True else [] if one is False else [flag, str(one)]
    return words


def run(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    run: Mapping[str, Any],
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for the files; default out/TASK-METHOD-SEED-OPTIONS.")
    ] = None,
    jobs: Annotated[int, Option(help="How many trials to run at once, each in its own process.")] = 1,
    strict: Annotated[bool, Option("--strict", help="Exit with code 1 if a goal was missed.")] = False,
    raise_errors: Annotated[bool, Option("--raise", help=ABOUT_RAISE)] = False,
    cache: CacheFolder = None,
    enable_motion: Annotated[bool, Option("--enable-motion", help="With --robot: let the arms move.")] = False,
    yes: Annotated[bool, Option("--yes", help="With --robot: do not ask before the arms move.")] = False,
    policy: Annotated[str, Option(metavar="WHAT", help=ABOUT_POLICY)] = "",
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    need("sim")
    from trocar.eval.folder import open_folder
    from trocar.eval.jobs import play_run  # the simulator is heavy
    from trocar.eval.prepare import CACHE

    if cache is not None:
        os.environ[CACHE] = str(cache)  # for this process, and those that it starts
    if raise_errors and jobs != 1:
        raise InvalidInput("--raise", "has no effect on trials in other processes", "drop --jobs")
    config = RunConfig(task(**options), **_with_policy(run, policy), plugins=tuple(map(str, plugin or ())))
    if config.robot:
        from trocar.cli.robot import run_robot

        if jobs != 1:
            raise InvalidInput(f"--jobs {jobs}", "is more than one robot can do at once", "drop --jobs")
        run_robot(config, out, enable_motion=enable_motion, yes=yes, strict=strict, as_json=as_json)
        return
    if enable_motion or yes:
        flag = "--enable-motion" if enable_motion else "--yes"
        raise InvalidInput(flag, "is for real arms, and no --robot is named", "drop it, or name a robot")
    if config.model == "lstm":
        need("learn")
    folder = out or default_folder(f"{task.name}-{config.method}-{config.seed}", config.unusual)
    todo = open_folder(config, folder)
    if not todo:
        kept = counted(config.sessions * config.trials, "trial")
        beside().print(f"nothing to run: {folder} has the run's {kept}", soft_wrap=True)
    interrupted = False
    try:
        with progress() as tick, CtrlC() as ctrl_c:

            def shown(work: str, done: int, total: int | None, now: str = "") -> None:
                ctrl_c.check()
                tick(work, done, total, now)

            for wrong in play_run(config, folder, todo, jobs=jobs, tick=shown, raise_errors=raise_errors):
                beside().print(wrong, soft_wrap=True, markup=False)
    except KeyboardInterrupt as stop:
        interrupted = True
        if str(stop):
            beside().print(str(stop), soft_wrap=True, markup=False)
    all_succeeded = finish(folder, as_json, interrupted)
    if interrupted or (strict and not all_succeeded):
        raise typer.Exit(130 if interrupted else 1)


def _with_policy(run: Mapping[str, Any], policy: str) -> dict[str, Any]:
    """Return the options of a run with those of its policy, which is tried out before anything is written."""
    asked = run["method"] in methods_of_any()
    if asked and not policy:
        raise InvalidInput(f"--method {run['method']}", "names no policy", "give --policy DIR, or module:function")
    if not policy:
        return dict(run)
    if not asked:
        remedy = f"give --method {' or '.join(methods_of_any())}"
        raise InvalidInput(f"--policy {policy}", "is used by another method than the one chosen", remedy)
    from trocar.learn.policy import load_policy, policy_digest

    with load_policy(policy):
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
    as_json: JsonFlag = False,
) -> None:
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
    plugins = tuple(str(path.absolute()) for path in plugin or ())
    values = options[of_task.varied]
    conditions = conditions_of(
        task, folder, values=values, methods=methods, options=own, sessions=sessions, seed=seed, plugins=plugins, **run
    )
    results, missing = worked(folder, conditions, of_task.kind, report_only, jobs, backend, scheduler)
    summary, tables, notes, files = write_study(folder, task.name, of_task, results, missing)
    _printed(summary, tables, notes, files).show(as_json)


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
    points = found.points(folder, [str(path.absolute()) for path in plugin or ()])
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
