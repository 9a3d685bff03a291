"""``trocar study TASK`` and ``trocar sweep FILE``: several conditions in the same sessions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trocar.cli.group import Known, Result
from trocar.cli.options import Flaws, JsonFlag, Level, Plugins, Seed, need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.progress import progress
from trocar.cli.task_group import TaskGroup
from trocar.cli.terminal import beside, rich_table
from trocar.errors import BadFile
from trocar.eval import TASKS, Task

if TYPE_CHECKING:
    from trocar.eval.study import Condition, Results, RowKind, TableData

Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/STUDY-SEED-OPTIONS.")]
Jobs = Annotated[int | None, typer.Option(min=1, help="How many trials to run at once.", show_default="one per core")]
Backend = Annotated[str, typer.Option(help="Where the work is done: processes, dask.")]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="Address of a dask cluster.", show_default="a cluster on this machine")
]
ReportOnly = Annotated[bool, typer.Option("--report-only", help="Run nothing; report on what is there.")]


def study(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    methods: Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="Which methods.")] = "",
    sessions: Annotated[int, typer.Option(help="How many days are drawn, the same for all conditions.")] = 10,
    trials: Annotated[int, typer.Option(help="How many trials in each session.")] = 1,
    model: Annotated[str, typer.Option(help="Cable model of methods that compensate.", show_default="play")] = "",
    station: Annotated[
        str, typer.Option(metavar="STATION", help="Name of a station, or a TOML file.", show_default="the task's")
    ] = "",
    difficulty: Level = "recorded",
    flaw: Flaws = None,
    seed: Seed = 0,
    out: Out = None,
    jobs: Jobs = None,
    backend: Backend = "processes",
    scheduler: Scheduler = "",
    report_only: ReportOnly = False,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Run every method in the same sessions, compare them, and set the paper's figures beside them."""
    need("sim", "mujoco", "trio", "cv2")
    from trocar.eval.study import conditions_of, study_of  # the simulator is heavy
    from trocar.report.study import write_study

    of_task = study_of(task)
    own = {name: value for name, value in options.items() if name != of_task.varied}
    given = {"model": model, "station": station, "difficulty": difficulty, "flaw": flaw, "plugin": plugin}
    name = f"study-{task.name}-{seed}"
    folder = out or default_folder(name, differing(study, given) | differing(task, own))
    conditions = conditions_of(
        task,
        folder,
        values=options[of_task.varied],
        methods=methods,
        model=model,
        options=own,
        station=station,
        difficulty=difficulty,
        flaws=tuple(flaw or ()),
        sessions=sessions,
        trials=trials,
        seed=seed,
        plugins=tuple(str(path.absolute()) for path in plugin or ()),
    )
    results, missing = _worked(folder, conditions, of_task.kind, report_only, jobs, backend, scheduler)
    summary, tables, notes, files = write_study(folder, task.name, of_task, results, missing)
    _printed(summary, tables, notes, files).show(as_json)


def sweep(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="TOML: task, methods, seeds, flaws with their sizes.")],
    *,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/FILE.")] = None,
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
    need("sim", "mujoco", "trio", "cv2")
    from trocar.report.sweep import KIND, Sweep, conditions_of, figures_of, tables_of, write_sweep

    found = Sweep.read(file)
    folder = out or Path("out") / file.stem
    points = found.points(folder, [str(path.absolute()) for path in plugin or ()])
    results, missing = _worked(folder, conditions_of(points), KIND, report_only, jobs, backend, scheduler)
    rows = {one.condition.folder: one.rows for one in results}
    figures = [figure for point in points if (figure := figures_of(point, rows)) is not None]
    summary, files = write_sweep(folder, found.task.name, figures, missing)
    return _printed(summary, tables_of(figures), summary["notes"], files)


def _worked(
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


MEMBERS = {
    "calibration": Known(
        "Print Table I of the paper and the errors of all cable models, from recordings of real arms.",
        "trocar.cli.study_calibration:calibration",
        "trocar study calibration --data data --out study --no-lstm",
    )
}


class _Studies(TaskGroup):
    body = staticmethod(study)
    kind = "study"
    about = "Runs every method in the same sessions, compares them, and sets the paper's figures beside them."
    example = "trocar study {task} --sessions 10 --seed 1 --out out/study"
    members = MEMBERS

    def tasks(self) -> list[str]:
        """Return the names of the tasks that have a study."""
        return [name for name in TASKS if TASKS[name].study is not None]

    def listed(self, task: type[Task]) -> str:
        """Return the option that takes several values."""
        from trocar.eval.study import study_of  # the simulator is heavy

        return study_of(task).varied


app = typer.Typer(
    cls=_Studies,
    help="Reproduce a paper's table beside the paper's own figures.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
)


@app.callback()
def studies(plugin: Plugins = None) -> None:
    """Reproduce a paper's table beside the paper's own figures."""
    del plugin  # loaded when it was parsed
