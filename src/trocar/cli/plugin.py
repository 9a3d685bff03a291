"""``--plugin FILE``: a Python file that registers your own tasks, methods, planners, cable models, perceptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from trocar.registry import load_plugin

FLAG = "--plugin"


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
        help="Python file that registers your own parts; may be given several times.",
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
