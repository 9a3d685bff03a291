"""``trocar console TASK``, and ``--watch`` of a run: a page on which a person watches, confirms, stops, takes over."""

from __future__ import annotations

import math
import webbrowser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from typer import Option

from trocar.cli.options import EnableMotion, OpenBrowser, Plugins, Yes, need
from trocar.cli.out_folder import default_folder
from trocar.cli.progress import progress
from trocar.cli.report import finish
from trocar.cli.robot import about_motion, agreed, play_on_robot, refuse_motion_flags
from trocar.cli.task_group import OF_RUN, TaskGroup
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput, InvalidValue, TrocarError, UnknownName
from trocar.eval import Method, Task, methods_of, methods_of_any, pick_method
from trocar.eval.config import RunConfig
from trocar.interruption import CtrlC

if TYPE_CHECKING:
    from trocar.console import Watch

ABOUT_CONFIRM = "What a script needs the person's yes for."
ABOUT_SPEED = "Seconds of the cell's clock per real second; 0: no limit."
ABOUT_DEVICES = "TCP port of this machine on which devices may move arms; 0: any free one."
ABOUT_OUT = "Folder for a run of each method; default out/console-TASK-SEED-OPTIONS."
NOTHING, MOTIONS = "nothing", "motions"


def console(
    *,
    task: type[Task],
    options: Mapping[str, Any],
    run: Mapping[str, Any],
    out: Annotated[Path | None, Option(metavar="DIR", help=ABOUT_OUT)] = None,
    confirm: Annotated[str, Option(metavar="motions|goals|nothing", help=ABOUT_CONFIRM)] = MOTIONS,
    speed: Annotated[float, Option(help=ABOUT_SPEED)] = 1.0,
    devices: Annotated[int | None, Option(metavar="PORT", min=0, max=65535, help=ABOUT_DEVICES)] = None,
    open_browser: OpenBrowser = True,
    enable_motion: EnableMotion = False,
    yes: Yes = False,
    plugin: Plugins = None,
) -> None:
    """Open the console, and keep it open: trial after trial, each with the method that the person chooses.

    The first trial begins at once. All are of one session, and each method's are a run in a folder of its own, which
    the same command continues. Ctrl-C ends, and reports on all.
    """
    need("sim")
    from trocar.eval.trial import trial_files

    plugins = tuple(map(str, plugin or ()))

    def config_of(method: str, trials: int = 1) -> RunConfig:
        return RunConfig(task(**options), **{**run, "method": method}, trials=trials, plugins=plugins)

    first = config_of(run["method"])
    if is_policy(first.chosen_method):
        problem = "is a learned policy, whose steps a person cannot confirm"
        raise InvalidInput(f"--method {first.method}", problem, "run it with `trocar run`")
    if first.model == "lstm":
        need("learn")
    refuse_speed(first, speed)
    folder = out or default_folder(f"console-{task.name}-{first.seed}", first.unusual)
    if first.robot:
        what = f"{task.name}, any method that is chosen on the page"
        about = about_motion(what, first.robot, first.laboratory, first.arms)
        asks = agreed(first.robot, about, enable_motion=enable_motion, yes=yes)
        if asks and not typer.confirm("is the table ready, and may the arms move?", err=True):
            raise typer.Exit(1)
    else:
        refuse_motion_flags(enable_motion=enable_motion, yes=yes)
    methods = [name for name in (*methods_of(task), *methods_of_any()) if not is_policy(pick_method(task, name))]
    used: dict[str, None] = {}
    try:
        with opened_console(confirm, speed, devices, opens=open_browser) as watch:
            method, words = first.method, ""
            while True:
                into = folder / method
                try:
                    words = _one_more(config_of(method, 1 + len(trial_files(into))), into, watch)
                    used[method] = None
                except TrocarError as error:
                    if not (words or watch.address):  # no page is open yet
                        raise
                    words = f"No trial with {method}: {error}"
                method = watch.next_method(words, [method, *(name for name in methods if name != method)])
    except KeyboardInterrupt:
        beside().print("ended; the same command continues")
    finally:
        for method in used:
            finish(folder / method, as_json=False, interrupted=False)


def _one_more(config: RunConfig, folder: Path, watch: Watch) -> str:
    """Run one trial more in a run's folder; return what it gave, in words."""
    from trocar.eval.folder import open_folder
    from trocar.eval.jobs import play_run  # the simulator is heavy
    from trocar.eval.trial import Trial, trial_file

    place = open_folder(config, folder)[0]
    if config.robot:
        from trocar.eval.on_robot import STOPPED

        trial = play_on_robot(config, folder, place, watch)
        if trial.ended == STOPPED:
            raise KeyboardInterrupt
    else:
        with progress() as tick, CtrlC() as ctrl_c:

            def shown(work: str, done: int, total: int | None, now: str = "") -> None:
                ctrl_c.check()
                tick(work, done, total, now)

            wrong = [*play_run(config, folder, [place], tick=shown, attendant=watch)]
        path = trial_file(folder, *place)
        if not path.is_file():
            return wrong[0]
        trial = Trial.load(path)
    done = sum(bool(score["succeeded"]) for score in trial.scores)
    stopped = "" if trial.finished else f", {trial.ended}: {trial.reason}"
    return f"Trial {place[1] + 1} with {config.method}: {done} of {len(trial.scores)} {trial.goal_noun}s{stopped}"


def refuse_speed(config: RunConfig, speed: float) -> None:
    """Raise if a speed is asked of real arms' clock."""
    if config.robot and speed != 1.0:
        raise InvalidInput(f"--speed {speed:g}", "is for the clock of a simulated cell", "drop it, or --robot")


@contextmanager
def opened_console(confirm: str, speed: float, devices: int | None, *, opens: bool = False) -> Iterator[Watch]:
    """Open a console, and at its end print the latency from a hand to the set-point.

    Args:
        confirm: what a script needs a yes for.
        speed: of the cell's clock.
        devices: port for devices; None: no devices.
        opens: whether to open the page in a browser.
    """
    if not (math.isfinite(speed) and speed >= 0):
        raise InvalidValue("--speed", speed, "give a number above 0, or 0 for no limit")
    need("view")
    from trocar.console import Watch  # the simulator is heavy
    from trocar.view.wishes import Level

    levels = {NOTHING: Level.AUTONOMOUS, "goals": Level.GOALS, "motions": Level.MOTIONS}
    if confirm not in levels:
        raise UnknownName("--confirm", confirm, list(levels))

    def told(address: str) -> None:
        beside().print("console:", address)
        if opens and address.startswith("http"):
            webbrowser.open(address)

    with Watch(levels[confirm], speed, inputs=devices, told=told) as watch:
        try:
            yield watch
        finally:  # an emergency stop ends the run by an error
            if watch.latencies_s:
                p50, p95 = 1e3 * np.percentile(watch.latencies_s, (50, 95))
                beside().print(f"from a hand to the set-point: p50 {p50:.0f} ms, p95 {p95:.0f} ms")


def is_policy(method: Method) -> bool:
    """Return whether a method is a learned policy, which has to be named."""
    return hasattr(method.make_settings(), "policy")


class _Consoles(TaskGroup):
    body = staticmethod(console)
    kind = "task"
    does = "Opens a page on which a person runs trial after trial: watches, confirms, stops, takes over."
    example = "trocar console {task} --seed 1"
    of_run = tuple(name for name in OF_RUN if name not in ("sessions", "trials"))


CONSOLE = _Consoles(
    "console",
    "Open a page for a person: begin trials, confirm each motion, stop, take arms over, do the task by hand.",
    {},
    epilog="Example: trocar console peg-transfer --seed 1",
)
