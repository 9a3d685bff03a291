"""What the commands of studies that run trials share: options, a progress bar, the work itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trocar.cli.progress import progress
from trocar.cli.terminal import beside
from trocar.errors import TrocarError

if TYPE_CHECKING:
    from trocar.eval.conditions import Cell
    from trocar.eval.study import ReadRow
    from trocar.eval.workers import Workers

Methods = Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="Which methods do the task.")]
Sessions = Annotated[int, typer.Option(help="How many days are drawn, the same for all conditions.")]
Trials = Annotated[int, typer.Option(help="How many trials in each session.")]
Model = Annotated[str, typer.Option(help="Cable model of methods that compensate.", show_default="play")]
StationName = Annotated[str, typer.Option(help="Name of a station, or a TOML file.", show_default="the task's")]
Seed = Annotated[int, typer.Option(help="Seed of everything random.")]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/study-TASK-SEED-OPTIONS.")
]
Jobs = Annotated[int | None, typer.Option(help="How many trials to run at once.", show_default="one per core")]
Backend = Annotated[str, typer.Option(help="Where the work is done: processes, dask.")]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="Address of a dask cluster.", show_default="a cluster on this machine")
]
ReportOnly = Annotated[bool, typer.Option("--report-only", help="Run nothing; report on what is there.")]
Plugin = Annotated[list[Path] | None, typer.Option(metavar="FILE", help="Python file that registers your own methods.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def loaded(plugin: Sequence[Path] | None) -> tuple[str, ...]:
    """Load plugins and return their paths."""
    from trocar.registry import load_plugin

    plugins = tuple(str(path.absolute()) for path in plugin or ())
    for path in plugins:
        load_plugin(path)
    return plugins


def workers_of(backend: str, jobs: int | None, scheduler: str) -> Workers:
    """Return the workers; by default one job per core."""
    from trocar.eval.workers import pick_workers  # the simulator is heavy

    return pick_workers(backend, jobs if jobs is not None else os.cpu_count() or 1, scheduler)


def require_study(folder: Path, report_only: bool) -> None:
    """Raise TrocarError if there is nothing to report on, or if the study's folder would be a file."""
    if folder.exists() and not folder.is_dir():
        raise TrocarError(f"--out {str(folder)!r} is a file; give a folder")
    if report_only and not any(folder.glob("*/run.json")):
        there = "holds no study" if folder.is_dir() else "does not exist"
        raise TrocarError(f"folder {str(folder)!r} {there}; give that of a study with --out, or drop --report-only")


def worked(
    cells: Sequence[Cell],
    read_row: ReadRow,
    results_of: Callable[..., tuple[list[Any], list[str]]],
    workers: Workers | None,
) -> tuple[list[Any], list[str]]:
    """Run the missing trials of a study, with a progress bar; return its results and a sentence per missing trial.

    Args:
        cells: of the study.
        read_row: makes the row of a trial.
        results_of: returns the results of cells, given a tick.
        workers: do the work; None: nothing is run.
    """
    from trocar.eval.study import run_study  # the simulator is heavy

    try:
        with progress() as tick:
            void = [] if workers is None else run_study(cells, read_row, workers, tick)
            results, missing = results_of(cells, tick)
    except KeyboardInterrupt:
        beside().print("stopped; finished trials are kept; run the same command to continue")
        raise typer.Exit(130) from None
    return results, [*void, *missing]
