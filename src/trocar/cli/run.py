"""``trocar run`` and ``trocar report``: play a task, look at what was kept."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from trocar.cli.extras import need
from trocar.errors import TrocarError
from trocar.sutures.plan_file import load_plan

if TYPE_CHECKING:
    from trocar.trials import Plan, Trial

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def run(
    task: Annotated[str, typer.Argument(metavar="TASK", help="peg-transfer or suture.")],
    *,
    variant: Annotated[
        str,
        typer.Option(
            help="peg-transfer: unilateral, one arm does all; suture: single-arm.", show_default="the task's first"
        ),
    ] = "",
    method: Annotated[
        str,
        typer.Option(help="calibrated: cables compensated by a fitted model; uncalibrated: encoders believed."),
    ] = "calibrated",
    model: Annotated[
        str,
        typer.Option(help="Cable model of the method calibrated: play, lstm (the paper's), ridge, offset."),
    ] = "play",
    trials: Annotated[int, typer.Option(help="How many trials: of twelve transfers, or of all sutures.")] = 1,
    seed: Annotated[int, typer.Option(help="Of everything random; the same seed gives the same trials.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/TASK-METHOD-SEED.")
    ] = None,
    new_session: Annotated[
        bool, typer.Option("--new-session", help="Draw new cable offsets between calibration and trials.")
    ] = False,
    refit_offsets: Annotated[
        bool,
        typer.Option("--refit-offsets", help="Refit the model's offsets from 30 samples before the trials."),
    ] = False,
    flawless_camera: Annotated[
        bool, typer.Option("--flawless-camera", help="Switch the sensor's flaws off; the run says so.")
    ] = False,
    preset: Annotated[
        str | None, typer.Option(help="suture: setup and reward of the plan.", show_default="default")
    ] = None,
    direction: Annotated[
        str | None,
        typer.Option(
            help="suture: best, or clockwise or counterclockwise for all, even where a joint cannot.",
            show_default="best",
        ),
    ] = None,
    sutures: Annotated[int | None, typer.Option(help="suture: how many, evenly spaced.", show_default="4")] = None,
    plan_file: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            metavar="FILE",
            help="suture: drive this plan.json of `trocar plan suture --out DIR`, which says all that a preset does.",
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures.

    An interrupted run keeps its finished trials; the same command goes on where it stopped.
    """
    need("sim", "mujoco", "trio", "cv2")
    from trocar.trials import Plan, open_folder  # noqa: PLC0415 (the simulator is heavy)

    if method == "calibrated" and model == "lstm":
        need("learn", "jax", "equinox", "optax")
    for option, value in (("--preset", preset), ("--direction", direction), ("--sutures", sutures)):
        if plan_file is not None and value is not None:
            raise TrocarError(
                f"{option} {value} cannot be combined with --plan {plan_file}: the plan says setup, places and "
                "directions; drop one of both"
            )
    plan = Plan(
        task,
        variant,
        method,
        model,
        trials,
        seed,
        new_session,
        refit_offsets,
        flawless_camera,
        preset,
        direction,
        sutures,
        load_plan(plan_file) if plan_file else None,
    )
    folder = out or Path("out") / f"{task}-{method}-{seed}"
    todo = open_folder(plan, folder)
    console = Console(stderr=True)
    interrupted = False
    try:
        _play(plan, folder, todo, console)
    except KeyboardInterrupt:
        interrupted = True
    _finish(folder, as_json, console, interrupted)
    if interrupted:
        raise typer.Exit(130)


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    *,
    as_json: JsonFlag = False,
) -> None:
    """Write summary, pictures and an HTML page from saved trials; nothing is recomputed."""
    need("sim", "cv2")
    _finish(folder, as_json, Console(stderr=True), interrupted=False)


def _play(plan: Plan, folder: Path, todo: Sequence[int], console: Console) -> None:
    from trocar.trials import prepare, run_trial, trial_file  # noqa: PLC0415

    if not todo:
        console.print(f"all {plan.trials} trials are in {folder}; nothing to run")
        return
    pieces = len(plan.built().work)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task(
            f"calibrating ({plan.model})" if plan.method == "calibrated" else "setting up",
            total=pieces * len(todo),
        )
        session, models = prepare(plan, folder)
        for number, index in enumerate(todo):

            def listen(event: Mapping[str, object], number: int = number, index: int = index) -> None:
                if event["name"] in ("transfer", "suture"):
                    progress.update(bar, advance=1, description=f"trial {index + 1} of {plan.trials}: {_done(event)}")

            trial = run_trial(plan, session, models, index, listen, pictures=index == 0)
            trial.save(trial_file(folder, index))
            progress.update(bar, completed=pieces * (number + 1))


def _done(event: Mapping[str, Any]) -> str:
    """Return what a script has just done."""
    if event["name"] == "transfer":
        return f"peg {event['source']} to {event['target']}"
    return f"suture {event['suture'] + 1}"


def _finish(folder: Path, as_json: bool, console: Console, interrupted: bool) -> None:
    from trocar.report import load_trials, write_report  # noqa: PLC0415

    if interrupted and not list(folder.glob("trial_*.npz")):
        console.print("stopped before the first trial was finished; the same command starts again")
        return
    trials = load_trials(folder)
    summary, files = write_report(folder, trials)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    _show(summary, trials, files, interrupted)


def _show(summary: Mapping[str, Any], trials: Sequence[Trial], files: Sequence[Path], interrupted: bool) -> None:
    from trocar.report import driven_table, parts_table, run_table  # noqa: PLC0415
    from trocar.report.summary import MISSED_WARNING  # noqa: PLC0415

    console = Console()
    console.print(run_table(summary))
    if "joint_error_deg" in summary:
        console.print(driven_table(summary))
    console.print(parts_table(summary))
    if summary["failures"]:
        console.print("failures: " + ", ".join(f"{name} {count}" for name, count in summary["failures"].items()))
    compute = ", ".join(f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in summary["compute_ms"].items())
    console.print(f"compute p50 / p95: {compute}; {summary['realtime_factor']:.1f} x real time")
    if summary["collisions_per_trial"] is not None:
        console.print(f"collisions a trial: {summary['collisions_per_trial']:.2f}")
    if summary["missed_budgets"] > MISSED_WARNING:
        console.print(
            f"warning: {100 * summary['missed_budgets']:.1f} % of computations took longer than the trial's clock "
            "counted for them; on this machine a real arm would have waited"
        )
    cables = "; ".join(f"{arm}: {source}" for arm, source in summary["cables"].items())
    console.print(f"simulated cables: {cables}")
    for sentence in [*summary.get("stopped", ()), *summary.get("modelled", ())]:
        console.print(sentence)
    if trials[0].about["flawless_camera"]:
        console.print("the camera's flaws were switched off")
    if interrupted:
        console.print(f"stopped; finished trials kept: {len(trials)}; the same command goes on")
    console.print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
