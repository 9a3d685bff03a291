"""``trocar study robustness TASK``: what success depends on, flaw by flaw."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from trocar.cli import study_cells as shared
from trocar.cli.extras import need
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.plugin import Plugins
from trocar.cli.task_group import TaskGroup
from trocar.cli.terminal import details, results
from trocar.eval import Task
from trocar.lab.flaws import FLAWS

if TYPE_CHECKING:
    from trocar.eval.conditions import Cell
    from trocar.report.robustness.results import Result


def robustness(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    methods: shared.Methods = "",
    flaws: Annotated[
        str, typer.Option(metavar="A,B,...", show_default="all that affect the station", help="Which flaws are varied.")
    ] = "",
    scales: Annotated[
        str,
        typer.Option(
            metavar="X,Y,...", help="Sizes of each flaw, as multiples of what was recorded.", show_default="0,1,2,4"
        ),
    ] = "",
    difficulty: Annotated[
        str, typer.Option(help="Difficulty of everything that is not varied: mild, recorded, harsh.")
    ] = "recorded",
    calibration: Annotated[
        str,
        typer.Option(
            help="What cable models are fitted on: images, or joints with drawn noise (fast).", show_default="joints"
        ),
    ] = "",
    model: shared.Model = "",
    station: shared.StationName = "",
    sessions: shared.Sessions = 10,
    trials: shared.Trials = 1,
    seed: shared.Seed = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/robustness-TASK-SEED-OPTIONS.")
    ] = None,
    jobs: shared.Jobs = None,
    backend: shared.Backend = "processes",
    scheduler: shared.Scheduler = "",
    report_only: shared.ReportOnly = False,
    plugin: Plugins = None,
    as_json: shared.AsJson = False,
) -> None:
    """Run a task against each flaw of a laboratory, at several sizes of it, and draw what its success depends on.

    Each size of each flaw is an ordinary run in a folder of the study's, and so is the laboratory as it is; all meet
    the same sessions. Trials are kept as they end; the same command continues where it stopped.
    """
    need("sim", "mujoco", "trio", "cv2")
    from trocar.report.robustness.conditions import cells_of, conditions_of  # the simulator is heavy
    from trocar.report.robustness.report import write_study
    from trocar.report.robustness.results import results_of
    from trocar.report.robustness.row import read_row

    workers = shared.workers_of(backend, jobs, scheduler)
    given = {"difficulty": difficulty, "calibration": calibration, "model": model, "station": station, "plugin": plugin}
    folder = out or default_folder(
        f"robustness-{task.name}-{seed}", differing(robustness, given) | differing(task, options)
    )
    shared.require_study(folder, report_only)
    conditions = conditions_of(
        folder,
        task(**options),
        methods=methods,
        flaws=flaws,
        scales=scales,
        difficulty=difficulty,
        calibration=calibration,
        model=model,
        station=station,
        sessions=sessions,
        trials=trials,
        seed=seed,
        plugins=shared.loaded(plugin),
    )

    def found_in(_: Sequence[Cell], tick: Callable[[str, int, int], None]) -> tuple[list[Result], list[str]]:
        return results_of(conditions, tick)

    found, notes = shared.worked(cells_of(conditions), read_row, found_in, None if report_only else workers)
    summary, files = write_study(folder, task.name, found, notes)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    shown = details()
    for flaw in dict.fromkeys(row["flaw"] for row in summary["conditions"]):
        shown.print(_table(flaw, [row for row in summary["conditions"] if row["flaw"] == flaw]))
    for sentence in summary["notes"]:
        shown.print(sentence)
    results().print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)


def _table(flaw: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(title=f"{flaw}: {FLAWS[flaw].about}", box=box.SIMPLE, padding=(0, 1, 0, 0))
    for column in ("method", "size", "goals reached", "%", "collisions per trial", "s for each"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for row in rows:
        low, high = (100 * end for end in row["success_ci95"])
        seconds = row["s_per_success"]
        table.add_row(
            row["method"],
            f"{row['size']:.3g} {row['unit']}" + (" (recorded)" if row["scale"] == 1.0 else ""),
            f"{row['succeeded']} of {row['goals']}",
            f"{100 * row['success']:.1f} [{low:.0f}, {high:.0f}]",
            f"{row['collisions_per_trial']['mean']:.2f}",
            f"{seconds['mean']:.1f}" if seconds else "-",
        )
    return table


class _Tasks(TaskGroup):
    body = staticmethod(robustness)
    told = "Runs trials against each flaw of a laboratory, at several sizes of it, and plots what success depends on."
    example = "trocar study robustness {task} --flaws registration,residual --sessions 10 --seed 1"


app = typer.Typer(
    cls=_Tasks,
    help="What a task's success depends on, flaw by flaw.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
)


@app.callback()
def tasks(plugin: Plugins = None) -> None:
    """Run a task against each flaw of a laboratory, at several sizes of it, and draw what its success depends on."""
    del plugin  # loaded when it was parsed
