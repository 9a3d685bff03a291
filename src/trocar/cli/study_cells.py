"""What commands of studies that run trials have in common: options, a progress bar, the work itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from trocar.trials.cells import Cell
    from trocar.trials.study import ReadRow
    from trocar.trials.workers import Workers

Methods = Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="How it is done.")]
Sessions = Annotated[int, typer.Option(help="How many days are drawn; the same ones for all.")]
Trials = Annotated[int, typer.Option(help="How many trials in each session.")]
StationName = Annotated[str, typer.Option(help="Name of a station, or a TOML file.", show_default="the task's")]
Seed = Annotated[int, typer.Option(help="Of everything random.")]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/study-TASK-SEED-OPTIONS.")
]
Jobs = Annotated[int | None, typer.Option(help="How many trials at once.", show_default="one a core")]
Backend = Annotated[str, typer.Option(help="Where the work is done: processes, dask.")]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="Of a dask cluster.", show_default="a cluster on this machine")
]
ReportOnly = Annotated[bool, typer.Option("--report-only", help="Run nothing; report on what is there.")]
Plugin = Annotated[
    list[Path] | None, typer.Option(metavar="FILE", help="Python file that registers methods of your own.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def loaded(plugin: Sequence[Path] | None) -> tuple[str, ...]:
    """Load plugins and return their paths."""
    from trocar.registry import load_plugin  # noqa: PLC0415

    plugins = tuple(str(path.absolute()) for path in plugin or ())
    for path in plugins:
        load_plugin(path)
    return plugins


def workers_of(backend: str, jobs: int | None, scheduler: str) -> Workers:
    """Return who work; a job a core where nothing is said."""
    from trocar.trials.workers import pick_workers  # noqa: PLC0415 (the simulator is heavy)

    return pick_workers(backend, jobs if jobs is not None else os.cpu_count() or 1, scheduler)


def worked(
    cells: Sequence[Cell],
    read_row: ReadRow,
    results_of: Callable[..., tuple[list[Any], list[str]]],
    workers: Workers | None,
) -> tuple[list[Any], list[str]]:
    """Run what a study lacks, with a progress bar; return its results and sentences on trials that are missing.

    Args:
        cells: of the study.
        read_row: makes the row of a trial.
        results_of: returns the results of cells, given a tick.
        workers: who work; None: nothing is run.
    """
    from trocar.trials.study import run_study  # noqa: PLC0415 (the simulator is heavy)

    console = Console(stderr=True)
    try:
        with _progress(console) as tick:
            void = [] if workers is None else run_study(cells, read_row, workers, tick)
            results, missing = results_of(cells, tick)
    except KeyboardInterrupt:
        console.print("stopped; finished trials are kept, and the same command goes on")
        raise typer.Exit(130) from None
    return results, [*void, *missing]


@contextmanager
def _progress(console: Console) -> Iterator[Any]:
    """Yield a function that shows what is done, how much of it, and how long it will take."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    with Progress(*columns, console=console, transient=True, speed_estimate_period=600) as progress:
        bars: dict[str, Any] = {}

        def tick(what: str, done: int, total: int) -> None:
            if what not in bars:
                bars[what] = progress.add_task(what, total=total, completed=done)
            progress.update(bars[what], completed=done)

        yield tick
