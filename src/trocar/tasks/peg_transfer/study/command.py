"""``trocar study peg-transfer``: all variants and methods, beside the paper's Tables II to IV and Figs. 9 to 11."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from trocar.cli import study_cells as options
from trocar.cli.difficulty import DEFAULT, Flaws, Level
from trocar.cli.out_folder import default_folder, differing
from trocar.cli.terminal import details, results

app = typer.Typer(rich_markup_mode=None, add_completion=False)


@app.command(epilog="Example: trocar study peg-transfer --sessions 12 --trials 2 --seed 1 --out out/study")
def peg_transfer(
    *,
    variants: Annotated[str, typer.Option(metavar="A,B,...", show_default="all", help="Variants of the task.")] = "",
    methods: options.Methods = "",
    sessions: options.Sessions = 10,
    trials: options.Trials = 1,
    transfers: Annotated[int, typer.Option(help="Only the first N of the twelve transfers.")] = 12,
    model: options.Model = "",
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
    """Run every method on every variant in the same sessions, compare them, and set the paper's figures beside them.

    Each condition is an ordinary run in DIR/VARIANT-METHOD. Trials are kept as they end; the same command continues
    where it stopped, whatever happened to it or its workers.
    """
    from trocar.tasks.peg_transfer.study.cells import cells_of  # the simulator is heavy
    from trocar.tasks.peg_transfer.study.report import write_study
    from trocar.tasks.peg_transfer.study.results import results_of
    from trocar.tasks.peg_transfer.study.row import read_row

    plugins = options.loaded(plugin)
    workers = options.workers_of(backend, jobs, scheduler)
    given = {
        "transfers": transfers,
        "model": model,
        "station": station,
        "difficulty": difficulty,
        "flaw": flaw,
        "plugin": plugin,
    }
    folder = out or default_folder(f"study-peg-transfer-{seed}", differing(peg_transfer, given))
    options.require_study(folder, report_only)
    cells = cells_of(
        folder,
        variants,
        methods,
        transfers=transfers,
        model=model,
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
    summary, found, files = write_study(folder, results, notes)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    _show(summary, found, notes, files)


def _show(summary: dict[str, Any], found: list[Any], notes: list[str], files: list[Path]) -> None:
    from trocar.tasks.peg_transfer.study.hypotheses import NOTES
    from trocar.tasks.peg_transfer.study.tables import hypothesis_table, variant_table

    console = details()
    for variant in dict.fromkeys(cell["variant"] for cell in summary["cells"]):
        console.print(variant_table(variant, summary["cells"]))
    if found:
        console.print(hypothesis_table(found))
    for sentence in [*NOTES, *notes]:
        console.print(sentence)
    results().print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
