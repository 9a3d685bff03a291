"""``trocar import lerobot`` replays the commands of a data set; ``trocar study demonstrations`` makes new ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Argument, Option

from trocar.cli.group import Result
from trocar.cli.options import Plugins, Seed, TaskOptions, need
from trocar.cli.out_folder import default_folder
from trocar.cli.progress import progress
from trocar.cli.report import export_episodes
from trocar.cli.run import Backend, Jobs, Scheduler, worked
from trocar.cli.task_group import OF_RUN, TaskGroup
from trocar.cli.terminal import beside
from trocar.counting import counted
from trocar.errors import InvalidInput, UnknownName
from trocar.eval import TASKS, Task
from trocar.eval.config import RunConfig


def import_lerobot(
    data: Annotated[Path, Argument(metavar="DIR", help="Folder of a LeRobot data set, v2.x or v3.x.")],
    *,
    task: Annotated[str, Option(help="The task that is laid out, and whose referee counts.")],
    option: TaskOptions = None,
    episode: Annotated[int, Option(min=0, help="Number of the episode.")] = 0,
    frame: Annotated[
        str, Option(metavar="world|base", help="What the data set's poses are in: the world, or each arm's base.")
    ] = "world",
    compensated: Annotated[
        bool, Option("--compensated", help="Compensate the cables by a model that is fitted first.")
    ] = False,
    seed: Seed = 0,
    difficulty: Annotated[str, Option(help="How far the laboratory departs from what is known about it.")] = "recorded",
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for the trial.", show_default="out/recorded-TASK-SEED-OPTIONS")
    ] = None,
    plugin: Plugins = None,
) -> Result:
    """Replay the commands of an episode in the cell, on cables that err, and keep the trial as any other.

    Prints how far tips and jaws truly were from where they were recorded. Commands beyond the arms' limits are played
    slower. Actions must be poses of tips, named as Open-H's data sets of dVRKs name them (psm1_sp.position.x, ...).
    """
    need("sim", "lerobot")
    from trocar.eval.folder import load_trials, open_folder  # the simulator is heavy
    from trocar.eval.jobs import play_run
    from trocar.eval.method import make_task
    from trocar.learn.read import read_episode
    from trocar.learn.replayed import COMPENSATED, METHOD, Source, deviations, register

    recorded = read_episode(data, episode)  # reports errors in the data before anything is made
    source = Source(str(data.absolute()), episode, frame, recorded.digest)
    kind = TASKS.pick(task)
    register(kind.name)
    config = RunConfig(
        make_task(kind, option or ()),
        method=COMPENSATED if compensated else METHOD,
        settings=tuple(f"{name}={value}" for name, value in asdict(source).items()),
        seed=seed,
        difficulty=difficulty,
        plugins=tuple(map(str, plugin or ())),
    )
    for arm in recorded.actions:
        if arm not in config.laboratory.arms:
            raise UnknownName("arm of the data set", arm, config.laboratory.arms)
    folder = out or default_folder(f"{config.method}-{task}-{seed}", config.unusual)
    with progress() as tick:
        wrong = list(play_run(config, folder, open_folder(config, folder), tick=tick))
    if wrong:
        raise InvalidInput("the replay", f"failed: {wrong[0]}")
    trials, strange = load_trials(folder)
    for sentence in strange:
        beside().print(sentence, soft_wrap=True)
    found, times = deviations(trials[0], source)
    counts = [score for score in trials[0].scores if score["attempted"]]
    reached = sum(bool(score["succeeded"]) for score in counts)
    summary: dict[str, Any] = {"out": str(folder), "data": str(data), "episode": episode, **times}
    summary |= {"attempted": len(counts), "succeeded": reached}
    summary["arms"] = {arm: asdict(deviation) for arm, deviation in found.items()}
    lines = [
        f"{arm}: its tip ended {1e3 * far.tip_end_m:.2f} mm from where it was recorded (RMS {1e3 * far.tip_rms_m:.2f} "
        f"mm, at most {1e3 * far.tip_max_m:.2f} mm), its jaws {np.rad2deg(far.jaw_end_rad):+.1f} deg "
        f"(RMS {np.rad2deg(far.jaw_rms_rad):.1f} deg)"
        for arm, far in found.items()
    ]
    lag_ms = 1e3 * times["lag_s"]
    lines.append(
        f"it took {times['replayed_s']:.1f} s, recorded in {times['recorded_s']:.1f} s; positions are taken to have "
        f"followed commands by {lag_ms:.0f} ms when they were recorded"
    )
    lines.append(f"{reached} of {len(counts)} {trials[0].goal_noun}s reached; the trial: {folder}")
    return Result(summary, lines)


KEEP, DROP = "keep", "drop"


def demonstrations(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    run: Mapping[str, Any],
    episodes: Annotated[int, Option(min=1, help="How many trials, each in a session of its own.")] = 10,
    failures: Annotated[
        str, Option(metavar="keep|drop", help="Whether trials that missed a goal become episodes.")
    ] = KEEP,
    layout: Annotated[str, Option(metavar="lerobot|open-h", help="As in `trocar export`.")] = "lerobot",
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for trials and data set; default out/demonstrations-TASK-...")
    ] = None,
    jobs: Jobs = None,
    backend: Backend = "processes",
    scheduler: Scheduler = "",
    plugin: Plugins = None,
) -> Result:
    """Let a method do a task in new sessions, on all cores, and write a LeRobot data set of it."""
    need("sim", "lerobot")
    from trocar.eval.study import Condition  # the simulator is heavy
    from trocar.eval.trial import Trial, trial_file
    from trocar.eval.trials import Trials
    from trocar.learn.episode import DEMONSTRATION
    from trocar.learn.meta import LAYOUTS

    if failures not in (KEEP, DROP):
        raise UnknownName("--failures", failures, (KEEP, DROP))
    if layout not in LAYOUTS:
        raise UnknownName("--layout", layout, LAYOUTS)
    plugins = tuple(map(str, plugin or ()))
    config = RunConfig(task(**options), **run, sessions=episodes, plugins=plugins, observations=True)
    usual = default_folder(f"demonstrations-{task.name}-{config.method}-{config.seed}", config.unusual)
    folder = (out or usual).absolute()
    condition = Condition("demonstrations", config, folder / "trials")
    results, missing = worked(folder, [condition], DEMONSTRATION, False, jobs, backend, scheduler)
    rows = [row for one in results for row in one.rows]
    reached = sum(row.success for row in rows)
    places = [place for place in condition.places if trial_file(condition.folder, *place).is_file()]
    trials: Sequence[Trial] = Trials([trial_file(condition.folder, *place) for place in places])
    for sentence in missing:
        beside().print(sentence, soft_wrap=True)
    written = export_episodes(trials, missing, folder / "data", layout, successes=failures == DROP)
    summary = {**written.summary, "trials": len(rows), "succeeded": reached}
    line = f"{reached} of {counted(len(rows), 'trial')} reached all goals; trials: {condition.folder}"
    return Result(summary, [line, *written.lines])


class _Demonstrations(TaskGroup):
    body = staticmethod(demonstrations)
    kind = "task"
    does = "Lets a method do the task in new sessions, on all cores, and writes a LeRobot data set of it."
    example = "trocar study demonstrations {task} --episodes 20 --seed 1 --out out/demonstrations"
    of_run = tuple(name for name in OF_RUN if name not in ("sessions", "trials", "robot", "cables"))


_ABOUT = "Let a method do a task in new sessions, on all cores: a LeRobot data set of it."
DEMONSTRATIONS = _Demonstrations("demonstrations", _ABOUT, {})
