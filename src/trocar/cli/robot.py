"""``--robot KIND:STATION.toml``: a person is told what will move, and is asked; then arms move."""

from __future__ import annotations

import sys
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import typer

from trocar.cli.out_folder import default_folder
from trocar.cli.report import finish
from trocar.cli.terminal import beside
from trocar.errors import InvalidInput
from trocar.eval.config import RunConfig
from trocar.lab import Station

if TYPE_CHECKING:
    from trocar.console import Watch
    from trocar.eval.trial import Trial


def run_robot(
    config: RunConfig,
    out: Path | None,
    *,
    enable_motion: bool,
    yes: bool,
    strict: bool,
    as_json: bool,
    attendant: Watch | None = None,
) -> None:
    """Run the remaining trials of a run, one after the other, and report on them.

    Raises:
        InvalidInput: motion is not enabled, or nobody is there to ask.
    """
    from trocar.eval.folder import open_folder
    from trocar.eval.on_robot import STOPPED
    from trocar.eval.trial import trial_file

    what = f"{config.task.name}, method {config.method}"
    about = about_motion(what, config.robot, config.laboratory, config.arms)
    asks = agreed(config.robot, about, enable_motion=enable_motion, yes=yes, as_json=as_json)
    folder = out or default_folder(f"{config.task.name}-{config.method}-{config.seed}", config.unusual)
    todo, stopped, left = open_folder(config, folder), False, False
    try:
        for number, (session, index) in enumerate(todo):
            if asks and not typer.confirm(f"trial {index}: is the table ready, and may the arms move?", err=True):
                left = True
                break
            trial = play_on_robot(config, folder, (session, index), attendant)
            if asks:
                trial.about["tally"] = _tally(len(trial.scores), trial.goal_noun)
                trial.save(trial_file(folder, session, index))
            stopped = trial.ended == STOPPED or (attendant is not None and bool(attendant.ended))
            if stopped:
                break
            hurt = _lasting_faults(trial.events)
            begins = number + 1 < len(todo) and not asks
            if hurt and begins:  # a new connection would forget the faults
                left = True
                beside().print(f"no other trial is begun by itself after: {'; '.join(hurt)}")
                break
    except typer.Abort:  # Ctrl-C at a question
        stopped = True
    all_succeeded = finish(folder, as_json, interrupted=stopped or left)
    if stopped or left or (strict and not all_succeeded):
        raise typer.Exit(130 if stopped else 1)


def play_on_robot(config: RunConfig, folder: Path, place: tuple[int, int], attendant: Watch | None) -> Trial:
    """Run one trial (its session and number) on real arms, and save it at once: arms cannot repeat it."""
    from trocar.eval.folder import set_aside
    from trocar.eval.on_robot import run_on_robot
    from trocar.eval.trial import trial_file

    trial, path = run_on_robot(config, place[1], _tell, attendant), trial_file(folder, *place)
    path.parent.mkdir(parents=True, exist_ok=True)
    set_aside(path)
    trial.save(path)
    return trial


def _lasting_faults(events: Iterable[Mapping[str, object]]) -> list[str]:
    """Return the faults after which an arm refuses to move until it is connected again."""
    from trocar.hardware.arm import PASSING

    passing = {fault.name.lower() for fault in PASSING}
    return [str(event["reason"]) for event in events if event["name"] == "fault" and event["fault"] not in passing]


def refuse_motion_flags(*, enable_motion: bool, yes: bool) -> None:
    """Raise if a flag for real arms is given where no robot is named."""
    if enable_motion or yes:
        flag = "--enable-motion" if enable_motion else "--yes"
        raise InvalidInput(flag, "is for real arms, and no --robot is named", "drop it, or name a robot")


def agreed(robot: str, about: Iterable[str], *, enable_motion: bool, yes: bool, as_json: bool = False) -> bool:
    """Tell a person what will move; return whether to ask before it does.

    Raises:
        InvalidInput: motion is not enabled, or nobody is there to ask.
    """
    for line in about:
        typer.echo(line, err=True)  # even with --quiet
    if not enable_motion:
        raise InvalidInput(f"--robot {robot}", "moves real arms, and motion is not enabled", "add --enable-motion")
    asks = sys.stdin.isatty() and not yes and not as_json
    if not (asks or yes):
        raise InvalidInput(f"--robot {robot}", "asks before arms move, and nobody is there to answer", "add --yes")
    return asks


def about_motion(what: str, robot: str, station: Station, arms: Container[str]) -> Iterator[str]:
    """Yield in sentences what will move, where, and how fast.

    Args:
        what: what is done.
        robot: as ``--robot`` names it.
        station: the robot's station.
        arms: the arms that work.
    """
    from trocar.hardware.kinds import robot_of

    kind, _ = robot_of(robot)
    yield f"{what}, at station {station.name!r}: {kind.about}"
    for name, arm in station.arms.items():
        does = "works" if name in arms else "is held where it is"
        yield f"  {name} {does}: {kind.where(station, name)}; at most {arm.speeds}"
        yield f"    its tip stays {_box(arm.workspace_m)}"


def _box(corners_m: np.ndarray | None) -> str:
    if corners_m is None:
        return "anywhere in its reach: the station's file has no box for it"
    sides = zip("xyz", *(1e3 * corners_m), strict=True)
    return "inside " + ", ".join(f"{axis} {low:.0f} to {high:.0f} mm" for axis, low, high in sides) + " of the world"


def _tell(event: Mapping[str, object]) -> None:
    said = ", ".join(f"{key} {value}" for key, value in event.items() if key not in ("name", "time_s", "traceback"))
    what = f"{event['name']}: {said}" if said else event["name"]
    beside().print(f"{event['time_s']:.1f} s: {what}", soft_wrap=True, highlight=False)


def _tally(goals: int, noun: str) -> int | None:
    """Return how many goals a person counted; None: nobody did."""
    while True:
        said = typer.prompt(
            f"how many {noun}s were done? 0 to {goals}, or nothing", default="", err=True, show_default=False
        )
        if not said:
            return None
        if said.isdecimal() and int(said) <= goals:
            return int(said)
