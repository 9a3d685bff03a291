"""``trocar study peg-transfer``: all variants and methods, beside the paper's Tables II to IV and Figs. 9 to 11."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

app = typer.Typer(rich_markup_mode=None, add_completion=False)


@app.command(epilog="Example: trocar study peg-transfer --sessions 12 --trials 2 --seed 1 --out out/study")
def peg_transfer(
    *,
    variants: Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="Of the task.")] = "",
    methods: Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="How it is done.")] = "",
    sessions: Annotated[int, typer.Option(help="How many days are drawn; the same ones for all.")] = 10,
    trials: Annotated[int, typer.Option(help="How many trials in each session.")] = 1,
    transfers: Annotated[int, typer.Option(help="Only the first so many of the twelve transfers.")] = 12,
    model: Annotated[str, typer.Option(help="Cable model of methods that compensate.")] = "play",
    station: Annotated[str, typer.Option(help="Name of a station, or a TOML file.", show_default="the task's")] = "",
    seed: Annotated[int, typer.Option(help="Of everything random.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/study-peg-transfer-SEED.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="How many trials at once.", show_default="one a core")] = None,
    backend: Annotated[str, typer.Option(help="Where the work is done: processes, dask.")] = "processes",
    scheduler: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Of a dask cluster.", show_default="a cluster on this machine")
    ] = "",
    report_only: Annotated[bool, typer.Option("--report-only", help="Run nothing; report on what is there.")] = False,
    plugin: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Python file that registers methods of your own.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run every method on every variant in the same sessions, compare them, and set the paper's figures beside them.

    Each condition is an ordinary run in DIR/VARIANT-METHOD. Trials are kept as they end; the same command goes on
    where it stopped, whatever happened to it or its workers.
    """
    from trocar.registry import load_plugin  # noqa: PLC0415 (the simulator is heavy)
    from trocar.tasks.peg_transfer.study.cells import cells_of  # noqa: PLC0415
    from trocar.tasks.peg_transfer.study.report import write_study  # noqa: PLC0415
    from trocar.tasks.peg_transfer.study.results import results_of  # noqa: PLC0415
    from trocar.tasks.peg_transfer.study.work import run_study  # noqa: PLC0415
    from trocar.trials.workers import pick_workers  # noqa: PLC0415

    plugins = tuple(str(path.absolute()) for path in plugin or ())
    for path in plugins:
        load_plugin(path)
    workers = pick_workers(backend, jobs if jobs is not None else os.cpu_count() or 1, scheduler)
    folder = out or Path("out") / f"study-peg-transfer-{seed}"
    cells = cells_of(
        folder,
        variants,
        methods,
        transfers=transfers,
        model=model,
        station=station,
        sessions=sessions,
        trials=trials,
        seed=seed,
        plugins=plugins,
    )
    console = Console(stderr=True)
    try:
        with _progress(console) as tick:
            void = [] if report_only else run_study(cells, workers, tick)
            results, missing = results_of(cells, tick)
    except KeyboardInterrupt:
        console.print("stopped; finished trials are kept, and the same command goes on")
        raise typer.Exit(130) from None
    notes = [*void, *missing]
    summary, found, files = write_study(folder, results, notes)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    _show(summary, found, notes, files)


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


def _show(summary: dict[str, Any], found: list[Any], notes: list[str], files: list[Path]) -> None:
    from trocar.tasks.peg_transfer.study.hypotheses import NOTES  # noqa: PLC0415
    from trocar.tasks.peg_transfer.study.tables import hypothesis_table, variant_table  # noqa: PLC0415

    console = Console()
    for variant in dict.fromkeys(cell["variant"] for cell in summary["cells"]):
        console.print(variant_table(variant, summary["cells"]))
    if found:
        console.print(hypothesis_table(found))
    for sentence in [*NOTES, *notes]:
        console.print(sentence)
    console.print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
