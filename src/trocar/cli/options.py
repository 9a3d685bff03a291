"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from trocar.cli.terminal import be_quiet
from trocar.errors import NotInstalled
from trocar.extras import EXTRAS
from trocar.registry import load_plugin

FLAG = "--plugin"

JsonFlag = Annotated[bool, Option("--json", help="Print one JSON object and nothing else.")]
Seed = Annotated[int, Option(min=0, help="Seed of everything random; the same seed gives the same result.")]
TaskOptions = Annotated[
    list[str] | None, Option(metavar="NAME=VALUE", help="Give an option of the task another value; repeatable.")
]
EnableMotion = Annotated[bool, Option("--enable-motion", help="With --robot: let the arms move.")]
Yes = Annotated[bool, Option("--yes", help="With --robot: do not ask before the arms move.")]
Port = Annotated[int, Option(min=0, max=65535, help="Port of the page; if it is taken, the next free one.")]
OpenBrowser = Annotated[bool, Option("--open/--no-open", help="Open a browser.")]
StationName = Annotated[str, Argument(metavar="STATION", help="Name of a built-in station, or a TOML file.")]


def _load(ctx: typer.Context, paths: list[Path] | None) -> list[Path]:
    """Load plugins before the rest of the line is parsed; return the absolute paths of all."""
    for path in paths or []:
        load_plugin(path)
    ctx.obj = [*(ctx.obj or []), *(path.absolute() for path in paths or [])]
    return ctx.obj


ABOUT_PLUGINS = "Python file that registers your own tasks, methods, planners, models; may be given several times."
Plugins = Annotated[list[Path] | None, Option(FLAG, metavar="FILE", help=ABOUT_PLUGINS, is_eager=True, callback=_load)]


def load_given(args: Sequence[str]) -> None:
    """Load all plugins named on a command line, before the names that they define are looked up."""
    for place, word in enumerate(args):
        if word == FLAG and place + 1 < len(args):
            load_plugin(args[place + 1])
        elif word.startswith(f"{FLAG}="):
            load_plugin(word.removeprefix(f"{FLAG}="))


def _listen(wanted: bool) -> None:
    """Be quiet if asked; without the option, an earlier request stays in force."""
    if wanted:
        be_quiet(True)


ABOUT_QUIET = "Print only errors and the last lines of the result: no progress, no tables."
Quiet = Annotated[bool, Option("--quiet", help=ABOUT_QUIET, is_eager=True, expose_value=False, callback=_listen)]


def need(*extras: str) -> None:
    """Raise NotInstalled if a module of one of these extras is not installed."""
    for extra in extras:
        missing = [module for module in EXTRAS[extra] if find_spec(module) is None]
        if missing:
            raise NotInstalled("this command", ", ".join(missing), extra)
