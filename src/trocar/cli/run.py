"""``trocar run``: run trials of a task."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trocar.cli.options import Flaws, JsonFlag, Level, Plugins, need
from trocar.cli.out_folder import default_folder
from trocar.cli.progress import progress
from trocar.cli.report import finish
from trocar.cli.task_group import TaskGroup
from trocar.cli.terminal import beside
from trocar.counting import counted
from trocar.errors import InvalidInput
from trocar.eval import Task
from trocar.interruption import CtrlC

if TYPE_CHECKING:
    from trocar.eval.config import RunConfig


def run(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    method: Annotated[str, typer.Option(help="Which method does the task", show_default="the first")] = "",
    model: Annotated[
        str,
        typer.Option(
            help="Cable model of methods that compensate: play, lstm (the paper's), ridge, offset.", show_default="play"
        ),
    ] = "",
    calibration: Annotated[
        str,
        typer.Option(
            help="What cable models are fitted on: images (of spheres on the arm) or joints (with drawn noise; fast).",
            show_default="images if the station's cameras allow it",
        ),
    ] = "",
    prior: Annotated[
        str,
        typer.Option(
            metavar="fleet|none|FILE", help="Fit on a minute of wide swings and what other instruments have in common."
        ),
    ] = "none",
    planner: Annotated[str, typer.Option(help="How motions are planned.", show_default="the method's")] = "",
    perception: Annotated[str, typer.Option(help="What turns images into poses.", show_default="the method's")] = "",
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Give a setting of the method another value; `trocar methods TASK` lists them; may be repeated.",
        ),
    ] = None,
    station: Annotated[
        str, typer.Option(metavar="STATION", help="Name of a station, or a TOML file.", show_default="the task's")
    ] = "",
    sessions: Annotated[int, typer.Option(help="How many days are drawn, each registered and calibrated.")] = 1,
    trials: Annotated[int, typer.Option(help="How many trials in each session.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of everything random; the same seed gives the same trials.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files; default out/TASK-METHOD-SEED-OPTIONS.")
    ] = None,
    new_session: Annotated[
        bool, typer.Option("--new-session", help="Remount the instruments between calibration and trials.")
    ] = False,
    refit_offsets: Annotated[
        bool, typer.Option("--refit-offsets", help="Refit the model's offsets from 30 samples before the trials.")
    ] = False,
    flawless_camera: Annotated[
        bool, typer.Option("--flawless-camera", help="Switch off the sensors' flaws; the run states this.")
    ] = False,
    difficulty: Level = "recorded",
    flaw: Flaws = None,
    jobs: Annotated[int, typer.Option(help="How many trials to run at once, each in its own process.")] = 1,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with code 1 if a goal was missed.")] = False,
    raise_errors: Annotated[
        bool, typer.Option("--raise", help="Stop at an exception of the agent, which else ends its trial only.")
    ] = False,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            envvar="TROCAR_CACHE",
            help="Folder where fitted cable models are kept for other runs.",
            show_default="~/.cache/trocar",
        ),
    ] = None,
    plugin: Plugins = None,
    as_json: JsonFlag = False,
) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    need("sim", "mujoco", "trio", "cv2")
    from trocar.eval.config import RunConfig  # the simulator is heavy
    from trocar.eval.folder import open_folder
    from trocar.eval.prepare import CACHE

    if cache is not None:
        os.environ[CACHE] = str(cache)  # for this process, and those that it starts
    if raise_errors and jobs != 1:
        raise InvalidInput("--raise", "has no effect on trials in other processes", "drop --jobs")
    config = RunConfig(
        task=task(**options),
        station=station,
        method=method,
        model=model,
        calibration=calibration,
        prior=prior,
        planner=planner,
        perception=perception,
        settings=tuple(settings or ()),
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
    if config.model == "lstm":
        need("learn", "jax", "equinox", "optax")
    folder = out or default_folder(f"{task.name}-{config.method}-{seed}", config.unusual)
    todo = open_folder(config, folder)
    interrupted = False
    try:
        if jobs == 1:
            _play(config, folder, todo, raise_errors)
        else:
            _play_at_once(config, folder.absolute(), todo, jobs)
    except KeyboardInterrupt as stop:
        interrupted = True
        if str(stop):
            beside().print(str(stop), soft_wrap=True, markup=False)
    all_succeeded = finish(folder, as_json, interrupted)
    if interrupted:
        raise typer.Exit(130)
    if strict and not all_succeeded:
        raise typer.Exit(1)


class _Tasks(TaskGroup):
    body = staticmethod(run)
    kind = "task"
    about = "Runs trials in the simulated cell, scores them, and keeps files and pictures."
    example = "trocar run {task} --trials 2 --seed 1 --out out/two"


app = typer.Typer(
    cls=_Tasks,
    help="Run trials of a task in the simulated cell, score them, and keep files and pictures.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
)


@app.callback(epilog="Example: trocar run peg-transfer --sessions 10 --trials 1 --seed 1 --out out/ten")
def runs(plugin: Plugins = None) -> None:
    """Run trials of a task in the simulated cell, score them, and keep files and pictures."""
    del plugin  # loaded when it was parsed


def _play(config: RunConfig, folder: Path, todo: Sequence[tuple[int, int]], raise_errors: bool) -> None:
    from trocar.eval.folder import set_aside
    from trocar.eval.run import AGENT_ERROR, free_memory, prepare, run_trial
    from trocar.eval.trial import trial_file

    if not todo:
        kept = counted(config.sessions * config.trials, "trial")
        beside().print(f"nothing to run: {folder} has the run's {kept}", soft_wrap=True)
        return
    goals, piece = len(config.task.goals()), config.task.goal_noun
    with progress() as tick, CtrlC() as ctrl_c:
        done, prepared = 0, None

        def say(now: str) -> None:
            ctrl_c.check()
            tick(f"{piece}s", done, goals * len(todo), now)

        for number, (session, index) in enumerate(todo):
            if prepared is None or prepared.number != session:
                day = f"session {session + 1} of {config.sessions}"
                say(f"{day}: setting up")

                def count(arm: str, image: int, total: int, day: str = day) -> None:
                    ctrl_c.check()
                    tick(f"{day}, images for the calibration of {arm}", image, total)

                prepared = prepare(config, session, folder, listener=count)
            where = f"session {session + 1}, trial {index + 1}"
            say(where)

            def listen(event: Mapping[str, object], where: str = where) -> None:
                nonlocal done
                if event["name"] == piece:
                    done += 1
                    say(f"{where}: a {piece} has ended")

            trial = run_trial(config, prepared, index, listen, raise_errors=raise_errors)
            path = trial_file(folder, session, index)
            set_aside(path)
            trial.save(path)
            free_memory()
            if trial.ended == AGENT_ERROR:
                beside().print(f"{where}: {trial.reason}; --raise stops there", soft_wrap=True, markup=False)
            done = goals * (number + 1)
            say(f"{where}: saved")


def _play_at_once(config: RunConfig, folder: Path, todo: Sequence[tuple[int, int]], jobs: int) -> None:
    from trocar.eval.jobs import SessionOrder, TrialOrder, calibrate, play
    from trocar.eval.workers import pick_workers, run_all

    workers = pick_workers("processes", jobs)
    sessions = [SessionOrder(((config, folder),), session) for session in dict.fromkeys(place[0] for place in todo)]
    with progress() as tick:
        tick("setting up sessions", 0, len(sessions))
        for done, _ in enumerate(run_all(calibrate, sessions, workers), start=1):
            tick("setting up sessions", done, len(sessions))
        tick("running trials", 0, len(todo))
        orders = [TrialOrder(config, folder, *place) for place in todo]
        for done, (_, void) in enumerate(run_all(play, orders, workers), start=1):
            tick("running trials", done, len(todo))
            if void:
                beside().print(void, soft_wrap=True)
