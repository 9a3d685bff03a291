"""``trocar run`` and ``trocar report``: play a task, look at what was kept."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from trocar.cli.difficulty import DEFAULT, Flaws, Level
from trocar.cli.extras import need
from trocar.cli.out_folder import default_folder
from trocar.cli.plugin import Plugins
from trocar.cli.progress import COLUMNS
from trocar.cli.task_group import TaskGroup
from trocar.tasks import TASKS, Task

if TYPE_CHECKING:
    from trocar.trials import Trial
    from trocar.trials.config import RunConfig

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def run(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    method: Annotated[str, typer.Option(help="How it is done", show_default="the first")] = "",
    model: Annotated[
        str,
        typer.Option(help="Cable model of methods that compensate: play, lstm (the paper's), ridge, offset."),
    ] = "play",
    calibration: Annotated[
        str,
        typer.Option(
            help="What cable models are fitted on: images (of spheres on the arm) or joints (with drawn noise; fast).",
            show_default="images where the station's cameras can",
        ),
    ] = "",
    prior: Annotated[
        str,
        typer.Option(
            metavar="fleet|none|FILE",
            help="Fit on a minute of wide swings, from what other instruments show, not on a long recording.",
        ),
    ] = "none",
    planner: Annotated[str, typer.Option(help="Of the motions.", show_default="the method's")] = "",
    perception: Annotated[str, typer.Option(help="What the agents see with", show_default="the method's")] = "",
    station: Annotated[
        str, typer.Option(metavar="STATION", help="Name of a station, or a TOML file.", show_default="the task's")
    ] = "",
    sessions: Annotated[int, typer.Option(help="How many days are drawn, each registered and calibrated anew.")] = 1,
    trials: Annotated[int, typer.Option(help="How many trials in each session.")] = 1,
    seed: Annotated[int, typer.Option(help="Of everything random; the same seed gives the same trials.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the files; default out/TASK-METHOD-SEED-OPTIONS."),
    ] = None,
    new_session: Annotated[
        bool, typer.Option("--new-session", help="Mount the instruments again between calibration and trials.")
    ] = False,
    refit_offsets: Annotated[
        bool, typer.Option("--refit-offsets", help="Refit the model's offsets from 30 samples before the trials.")
    ] = False,
    flawless_camera: Annotated[
        bool, typer.Option("--flawless-camera", help="Switch the sensors' flaws off; the run says so.")
    ] = False,
    difficulty: Level = DEFAULT,
    flaw: Flaws = None,
    jobs: Annotated[int, typer.Option(help="How many trials at once, each in a process of its own.")] = 1,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    need("sim", "mujoco", "trio", "cv2")
    from trocar.trials.config import RunConfig  # noqa: PLC0415 (the simulator is heavy)
    from trocar.trials.folder import open_folder  # noqa: PLC0415

    config = RunConfig(
        task=task(**options),
        station=station,
        method=method,
        model=model,
        calibration=calibration,
        prior=prior,
        planner=planner,
        perception=perception,
        sessions=sessions,
        trials=trials,
        seed=seed,
        new_session=new_session,
        refit_offsets=refit_offsets,
        flawless_camera=flawless_camera,
        difficulty=difficulty,
        flaws=tuple(flaw or ()),
        plugins=tuple(map(str, plugin or ())),
    )
    if config.chosen_method.calibrated and model == "lstm":
        need("learn", "jax", "equinox", "optax")
    folder = out or default_folder(f"{task.name}-{config.method}-{seed}", config.unusual)
    todo = open_folder(config, folder)
    console = Console(stderr=True)
    interrupted = False
    try:
        if jobs == 1:
            _play(config, folder, todo, console)
        else:
            _play_at_once(config, folder.absolute(), todo, jobs, console)
    except KeyboardInterrupt:
        interrupted = True
    all_succeeded = _finish(folder, as_json, console, interrupted)
    if interrupted:
        raise typer.Exit(130)
    if not all_succeeded:
        raise typer.Exit(1)


class _Tasks(TaskGroup):
    body = staticmethod(run)
    told = "Runs trials in the simulated cell, scores them, and keeps files and pictures."
    example = "trocar run {task} --trials 2 --seed 1 --out out/two"


app = typer.Typer(
    cls=_Tasks,
    help="Run trials of a task in the simulated cell, score them, and keep files and pictures.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.callback(epilog="Example: trocar run peg-transfer --sessions 10 --trials 1 --seed 1 --out out/ten")
def runs(plugin: Plugins = None) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    del plugin  # loaded when it was parsed


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    *,
    video: Annotated[
        bool, typer.Option("--video", help="Also make a short moving picture of the first trial, video.webp.")
    ] = False,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Write summary, pictures, replay and an HTML page from saved trials; nothing is recomputed."""
    del plugin  # loaded when it was parsed
    console = Console(stderr=True)
    _finish(folder, as_json, console, interrupted=False)
    if video:
        _draw_video(folder, console)


def _draw_video(folder: Path, console: Console) -> None:
    from trocar.report.files import report_of  # noqa: PLC0415
    from trocar.report.video import draw_video  # noqa: PLC0415
    from trocar.trials import load_trials  # noqa: PLC0415

    trial = load_trials(folder)[0][0]
    with Progress(*COLUMNS, console=console, transient=True) as progress:
        bar = progress.add_task("drawing video.webp")
        path = draw_video(
            trial,
            folder / "video.webp",
            report_of(trial),
            lambda done, total: progress.update(bar, completed=done, total=total),
        )
    console.print(f"video: {path}", soft_wrap=True)


def _play(config: RunConfig, folder: Path, todo: Sequence[tuple[int, int]], console: Console) -> None:
    from trocar.trials.folder import set_aside  # noqa: PLC0415
    from trocar.trials.run import prepare, run_trial  # noqa: PLC0415
    from trocar.trials.trial import trial_file  # noqa: PLC0415

    if not todo:
        console.print(f"all {config.sessions * config.trials} trials are in {folder}; nothing to run")
        return
    goals = len(config.task.goals())
    with Progress(*COLUMNS, console=console, transient=True) as progress:
        bar = progress.add_task("starting", total=goals * len(todo))
        prepared = None
        for number, (session, index) in enumerate(todo):
            if prepared is None or prepared.number != session:
                what = f"calibrating ({config.model})" if config.chosen_method.calibrated else "setting up"
                progress.update(bar, description=f"session {session + 1} of {config.sessions}: {what}")

                def count(done: int, total: int, what: str = f"session {session + 1} of {config.sessions}") -> None:
                    progress.update(bar, description=f"{what}: image {done} of {total}")

                prepared = prepare(config, session, folder, listener=count)
            where = f"session {session + 1}, trial {index + 1}"

            def listen(event: Mapping[str, object], where: str = where) -> None:
                if event["name"] == config.task.piece:
                    progress.update(bar, advance=1, description=f"{where}: a {config.task.piece} has ended")

            trial, path = run_trial(config, prepared, index, listen), trial_file(folder, session, index)
            set_aside(path)
            trial.save(path)
            progress.update(bar, completed=goals * (number + 1))


def _play_at_once(
    config: RunConfig, folder: Path, todo: Sequence[tuple[int, int]], jobs: int, console: Console
) -> None:
    from trocar.trials.orders import SessionOrder, TrialOrder, calibrate, play  # noqa: PLC0415
    from trocar.trials.workers import pick_workers, run_all  # noqa: PLC0415

    workers = pick_workers("processes", jobs)
    sessions = [SessionOrder(((config, folder),), session) for session in dict.fromkeys(place[0] for place in todo)]
    with Progress(*COLUMNS, console=console, transient=True) as progress:
        bar = progress.add_task("setting up sessions", total=len(sessions))
        for _ in run_all(calibrate, sessions, workers):
            progress.advance(bar)
        bar = progress.add_task("running trials", total=len(todo))
        for _, void in run_all(play, [TrialOrder(config, folder, *place) for place in todo], workers):
            progress.advance(bar)
            if void:
                console.print(void, soft_wrap=True)


def _finish(folder: Path, as_json: bool, console: Console, interrupted: bool) -> bool:
    """Write and print what a folder's trials say; return whether every goal of all of them was reached."""
    from trocar.report.files import write_report  # noqa: PLC0415
    from trocar.trials import load_trials, trial_files  # noqa: PLC0415
    from trocar.trials.folder import still_to_do  # noqa: PLC0415

    if interrupted and not trial_files(folder):
        console.print("stopped before the first trial was finished; the same command starts again")
        return False
    trials, strange = load_trials(folder)
    strange += still_to_do(folder, len(trials))
    task = trials[0].about["task"]
    if task not in TASKS:
        strange.append(
            f"task {task!r} is unknown here, so its own pictures and figures are left out; add --plugin FILE"
        )
    summary, files = write_report(folder, trials, strange)
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        _show(summary, trials, strange, files, interrupted)
    return summary["succeeded"] == summary["attempted"]


def _show(
    summary: Mapping[str, Any],
    trials: Sequence[Trial],
    strange: Sequence[str],
    files: Sequence[Path],
    interrupted: bool,
) -> None:
    from trocar.report.files import report_of  # noqa: PLC0415
    from trocar.report.summary import MISSED_WARNING  # noqa: PLC0415
    from trocar.report.tables import parts_table, run_table  # noqa: PLC0415

    report = report_of(trials[0])
    console = Console()
    console.print(run_table(summary, report.paper_rows(summary)))
    for table in [*report.tables(summary), parts_table(summary)]:
        console.print(table)
    for trial in (trial for trial in trials if not trial.finished):
        where = f"session {trial.about['session']}, trial {trial.about['index']}"
        console.print(f"{where} was stopped ({trial.ended}): {trial.reason}")
    if summary["failures"]:
        console.print("failures: " + ", ".join(f"{name} {count}" for name, count in summary["failures"].items()))
    compute = ", ".join(f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in summary["compute_ms"].items())
    if compute and summary["realtime_factor"]:
        console.print(f"compute p50 / p95: {compute}; {summary['realtime_factor']:.1f} x real time")
    use = summary["command_limit_use"]
    console.print(
        f"collisions a trial: {summary['collisions_per_trial']:.2f}; largest share of the limits that was sent: "
        f"velocity {use['velocity']:.2f}, acceleration {use['acceleration']:.2f}"
    )
    if summary["missed_budgets"] > MISSED_WARNING:
        console.print(
            f"warning: {100 * summary['missed_budgets']:.1f} % of computations took longer than the trial's clock "
            "counted for them; on this machine a real arm would have waited"
        )
    for what, how in summary["flaws"].items():
        console.print(f"{what}: {how}")
    for sentence in [*report.notes(trials), *strange]:
        console.print(sentence)
    if interrupted:
        console.print(f"stopped; finished trials kept: {len(trials)}; the same command goes on")
    console.print("files: " + ", ".join(str(file) for file in files), soft_wrap=True)
    for replay in (file for file in files if file.name == "replay.html"):
        console.print(f"watch it: open {replay} in any browser", soft_wrap=True)
