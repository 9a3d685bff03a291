"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.main import get_command

from trocar.cli.terminal import be_quiet
from trocar.errors import NotInstalled
from trocar.registry import load_plugin

FLAG = "--plugin"

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random; the same seed gives the same result.")]
StationName = Annotated[str, typer.Argument(metavar="STATION", help="Name of a built-in station, or a TOML file.")]
Level = Annotated[
    str, typer.Option(help="How far the laboratory departs from what is known about it: mild, recorded, harsh.")
]
Flaws = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=SIZE", help="Give a flaw another size, as registration=1.0mm; may be repeated."),
]


def _load(ctx: typer.Context, paths: list[Path] | None) -> list[Path]:
    """Load the files before anything else is parsed; return all of them, wherever they are on the command line."""
    for path in paths or []:
        load_plugin(path)
    ctx.obj = [*(ctx.obj or []), *(paths or [])]
    return ctx.obj


Plugins = Annotated[
    list[Path] | None,
    typer.Option(
        FLAG,
        metavar="FILE",
        help="Python file that registers your own tasks, methods, planners, models; may be given several times.",
        is_eager=True,
        callback=_load,
    ),
]


def load_given(args: Sequence[str]) -> None:
    """Load all plugins named on a command line, before the names that they define are looked up."""
    for place, word in enumerate(args):
        if word == FLAG and place + 1 < len(args):
            load_plugin(args[place + 1])
        elif word.startswith(f"{FLAG}="):
            load_plugin(word.removeprefix(f"{FLAG}="))


def _listen(wanted: bool) -> None:
    """Be quiet if asked; the option's absence does not undo an earlier request."""
    if wanted:
        be_quiet(True)


Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet",
        help="Print only errors and the last lines of the result: no progress, no tables.",
        is_eager=True,
        expose_value=False,
        callback=_listen,
    ),
]


@cache
def quiet_option() -> Any:
    """Return the option as a parameter to add to an existing command."""
    app = typer.Typer(rich_markup_mode=None, add_completion=False)

    @app.command()
    def donor(quiet: Quiet = False) -> None:
        del quiet

    return get_command(app).params[0]


def need(extra: str, *modules: str) -> None:
    """Raise NotInstalled if a module of an extra is not installed."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise NotInstalled("this command", ", ".join(missing), extra)
