"""The command that repeats a run."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from trocar.eval import TASKS, pick_method
from trocar.lab.flaws import DEFAULT
from trocar.lab.station_file import built_in_stations, station_digest

FILE = "FILE"
"""Placeholder for a path, because a run stores the content of its files, not their paths."""


def command_of(about: Mapping[str, Any], sessions: int, trials: int) -> str:
    """Return the command that runs the same trials again (``trials`` a session), ``FILE`` for each file given.

    ``about`` is a trial's: what distinguishes its run from others.
    """
    task = TASKS[about["task"]] if about["task"] in TASKS else None  # noqa: SIM401 (a registry has no get)
    words: list[str] = ["trocar", "run", about["task"]]
    words += ["--plugin", FILE] * len(about["plugins"])
    words += _options(task, about["options"])
    words += ["--method", about["method"]]
    if about["model"] and about["model"] != "play":
        words += ["--model", about["model"]]
    if about["calibration"]:
        words += ["--calibration", about["calibration"]]
    if about["prior"] not in (None, "none"):
        words += ["--prior", about["prior"] if about["prior"] == "fleet" else FILE]
    usual = pick_method(task, about["method"]) if task is not None else None
    for name in ("planner", "perception"):
        if about[name] and (usual is None or about[name] != getattr(usual, name)):
            words += [f"--{name}", about[name]]
    for setting in about["set"]:
        words += ["--set", setting]
    words += _station(task, about)
    level, *named = map(str, about["difficulty"] or [DEFAULT])
    words += ["--difficulty", level] if level != DEFAULT else []
    for flaw in named:
        words += ["--flaw", flaw]
    switches = ("new_session", "refit_offsets", "flawless_camera")
    words += [f"--{name.replace('_', '-')}" for name in switches if about[name]]
    words += ["--sessions", str(sessions), "--trials", str(trials), "--seed", str(about["seed"])]
    return shlex.join(words)


def _options(task: Any, given: Mapping[str, Any]) -> list[str]:
    """Return the task's own options that differ from their defaults; all, if the task is unknown here."""
    usual = task().options() if task is not None else {}
    flags = {f.name: f.metadata.get("flag") or f.name for f in fields(task)} if task is not None else {}
    words: list[str] = []
    for name, value in given.items():
        if value is None or (name in usual and usual[name] == value):
            continue
        flag = f"--{flags.get(name, name).replace('_', '-')}"
        if isinstance(value, bool):
            words.append(flag if value else f"--no-{flag[2:]}")
        else:
            words += [flag, FILE if isinstance(value, dict | list) else str(value)]
    return words


def _station(task: Any, about: Mapping[str, Any]) -> list[str]:
    """Return the option of the station, if it is not the task's default."""
    name, digest = about["station"], about["station_digest"]
    built_in = name in built_in_stations() and digest == station_digest(name)
    if built_in and task is not None and name == task.station:
        return []
    return ["--station", name if built_in else FILE]
