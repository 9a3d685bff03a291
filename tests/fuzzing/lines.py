"""Lines for every command there is, with options as somebody careless or hostile gives them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from typer.main import get_command

from fuzzing.files import altered, good_files
from fuzzing.values import KNOWN, typed, typed_numbers, typed_words
from trocar.cli import app
from trocar.cli.group import Deferred
from trocar.lab import built_in_stations

STATIONS = tuple(f"{name}.toml" for name in built_in_stations())
TRIAL = "run/session_00/trial_000.npz"

FITTING: dict[str, tuple[str, ...]] = {
    "recording": ("recording.npz",),
    "recordings": ("recording.npz", "recording.npz"),
    "model_file": ("offset.npz", "ridge.npz"),
    "bag": ("trial.mcap",),
    "path": ("joints.csv",),
    "waypoints": ("waypoints.npy",),
    "robot": ("points.npy",),
    "camera": ("points.npy",),
    "capture": ("capture.npz",),
    "station": (*STATIONS, *built_in_stations()),
    "folder": ("run",),
    "folders": ("run",),
    "plan": ("plan.json",),
    "demonstrations": ("demonstrations", "synthetic"),
    "data": ("folder", "run"),
    "prior": ("prior.npz", "fleet", "none"),
    "plugin": ("broken.py",),
    "out": ("out", "out.npz", "out.csv", "out.json", "recording.npz", "run", "plan.json"),
    "plot": ("plot.png", "plot.pdf", "recording.npz"),
    "analyse recording": ("joints.csv", TRIAL),
    "images": ("out", "run"),
    "commanded": ("/PSM1/setpoint_js", "/PSM2/jaw/setpoint_js"),
    "measured": ("/PSM1/true_js", "/PSM2/true_cp"),
    "namespace": ("/PSM1", "PSM2"),
    "import out": ("out.npz",),
    "fit out": ("out.npz",),
    "prior out": ("out.npz",),
    "apply out": ("out.csv",),
    "excite out": ("out.csv",),
    "transfer out": ("out.csv", "out.json", "out.npz"),
}
"""Good values of parameters that take files or folders; with a command's name before it, of that one's."""


@dataclass(frozen=True)
class Case:
    """A line and what it is typed in.

    Attributes:
        words: after ``trocar``.
        columns: the variable COLUMNS.
        encoding: of stdout.
    """

    words: tuple[str, ...]
    columns: str
    encoding: str


def commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words of every command and the command itself."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), get_command(app))]
    while waiting:
        words, command = waiting.pop()
        command = command.load() if isinstance(command, Deferred) else command
        if not hasattr(command, "list_commands"):
            yield words, command
            continue
        context = command.make_context(" ".join(words) or "trocar", [], resilient_parsing=True)
        waiting += [((*words, name), command.get_command(context, name)) for name in command.list_commands(context)]


COMMANDS = dict(sorted(commands()))


@st.composite
def cases(draw: st.DrawFn, folder: Path) -> Case:
    """Return a line; what it reads lies in ``folder``, altered files in ``folder/bad``."""
    words = draw(st.sampled_from(list(COMMANDS)))
    parameters = COMMANDS[words].params
    line = list(words)
    for parameter in parameters:
        if parameter.param_type_name == "argument":
            for _ in range(2 if parameter.nargs == -1 else 1):
                line.append(_value(draw, words, parameter, folder))
    options = [p for p in parameters if p.param_type_name == "option" and p.name != "help"]
    asked = [p for p in options if p.required]
    asked += draw(st.lists(st.sampled_from(options), max_size=3)) if options else []
    for option in asked:
        flags = [*option.opts, *option.secondary_opts]
        line.append(draw(st.sampled_from(flags)) if len(flags) > 1 else flags[0])
        if not option.is_flag:
            line += [_value(draw, words, option, folder) for _ in range(max(1, option.nargs))]
    if draw(st.integers(0, 39)) == 0:
        line.insert(draw(st.integers(0, len(line))), draw(typed))
    columns = draw(st.sampled_from(["80"] * 6 + ["0", "1", "-5", "x", "9" * 30, ""]))
    return Case(tuple(line), columns, draw(st.sampled_from(["utf-8"] * 3 + ["ascii"])))


def _value(draw: st.DrawFn, words: tuple[str, ...], parameter: Any, folder: Path) -> str:
    """Return a value of a parameter: often of the right kind, often altered, sometimes anything."""
    name = "model_file" if (parameter.name, parameter.param_type_name) == ("model", "argument") else parameter.name
    fitting = FITTING.get(f"{words[-1]} {name}") or FITTING.get(name)
    if fitting and draw(st.integers(0, 9)):
        chosen = draw(st.sampled_from(fitting))
        return chosen if name in ("out", "plot") or draw(st.integers(0, 3)) == 0 else _bad(draw, chosen, folder)
    if isinstance(parameter.default, int | float) or parameter.nargs > 1:
        return draw(typed_numbers) if draw(st.integers(0, 7)) else draw(typed_words)
    return draw(typed | st.sampled_from(KNOWN) | st.sampled_from(good_files(folder)))


def _bad(draw: st.DrawFn, name: str, folder: Path) -> str:
    """Return the name of an altered copy of a good file, or of a good folder in which one file is altered."""
    source, target = folder / name, folder / "bad" / name
    if not source.exists():
        return name
    if source.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(draw(altered(folder, name)))
        return str(target.relative_to(folder))
    shutil.copytree(source, target, dirs_exist_ok=True)
    inside = [one for one in good_files(folder) if one.startswith(f"{name}/")]
    if inside:
        one = draw(st.sampled_from(inside))
        (folder / "bad" / one).write_bytes(draw(altered(folder, one)))
    return str(target.relative_to(folder))
