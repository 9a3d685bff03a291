"""``trocar study debridement``: one arm and two, all methods, beside Table I of the paper."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from trocar.cli import study_cells as options
from trocar.cli.difficulty import DEFAULT, Flaws, Level
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.terminal import details, results
from trocar.counting import counted

app = typer.Typer(rich_markup_mode=None, add_completion=False)


@app.command(epilog="Example: trocar study debridement --methods paper,best --sessions 10 --seed 1 --out out/study")
def debridement(
    *,
    arms: Annotated[str, typer.Option(metavar="1,2", show_default="1 and 2", help="How many arms work.")] = "",
    methods: options.Methods = "",
    sessions: options.Sessions = 10,
    trials: options.Trials = 1,
    fragments: Annotated[int, typer.Option(help="How many fragments there are in each trial.")] = 6,
    budget: Annotated[float, typer.Option(metavar="S", help="A trial that takes longer is stopped.")] = 1800.0,
    station: options.StationName = "",
    difficulty: Level = DEFAULT,
    flaw: Flaws = None,
    seed: options.Seed = 0,
    out: options.Out = None,
    jobs: options.Jobs = None,
    backend: options.Backend = "processes",
    scheduler: options.Scheduler = "",
    report_only: options.ReportOnly = False,
    plugin: options.Plugin = None,
    as_json: options.AsJson = False,
) -> None:
    """Run every method with one arm and with two in the same sessions, and set Table I of the paper beside them.

    Each condition is an ordinary run in DIR/ARMS-METHOD. Trials are kept as they end; the same command continues where
    it stopped, whatever happened to it or its workers.
    """
    from trocar.tasks.debridement.study.cells import cells_of  # the simulator is heavy
    from trocar.tasks.debridement.study.report import write_study
    from trocar.tasks.debridement.study.results import read_row, results_of

    plugins = options.loaded(plugin)
    workers = options.workers_of(backend, jobs, scheduler)
    given = {
        "fragments": fragments,
        "budget": budget,
        "station": station,
        "difficulty": difficulty,
        "flaw": flaw,
        "plugin": plugin,
    }
    folder = out or default_folder(f"study-debridement-{seed}", differing(debridement, given))
    options.require_study(folder, report_only)
    cells = cells_of(
        folder,
        arms,
        methods,
        fragments=fragments,
        budget_s=budget,
        station=station,
        difficulty=difficulty,
        flaws=tuple(flaw or ()),
        sessions=sessions,
        trials=trials,
        seed=seed,
        plugins=plugins,
    )
    results, missing = options.worked(cells, read_row, results_of, None if report_only else workers)
    notes = [f"difficulty of the cell: {', '.join(cells[0].config.how_difficult)}", *missing]
    summary, files = write_study(folder, results, notes)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    _show(summary, notes, files)


def _show(summary: dict[str, Any], notes: list[str], files: list[Path]) -> None:
    from trocar.tasks.debridement.report.table_one import table_one
    from trocar.tasks.debridement.study.report import NOTES, SPEED_HEAD, left_behind, speed_lines

    console = details()
    for cell in summary["cells"]:
        what = f"Table I, {cell['variant'].replace('-', ' ')}, {cell['method']}"
        title = f"{what}: {counted(cell['trials'], 'trial')} in {counted(cell['sessions'], 'session')}"
        console.print(table_one(cell["variant"], cell, title))
    if summary["speedups"]:
        table = Table(*SPEED_HEAD, title="One arm against two", box=box.SIMPLE, padding=(0, 1, 0, 0))
        for line in speed_lines(summary["speedups"]):
            table.add_row(*line)
        console.print(table)
    for sentence in [*left_behind(summary["cells"]), *NOTES, *notes]:
        console.print(sentence)
    results().print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
