"""``--difficulty LEVEL`` and ``--flaw NAME=SIZE``: how far a laboratory departs from what is known about it."""

from __future__ import annotations

from typing import Annotated

import typer

from trocar.lab.flaws import DEFAULT, LEVELS

__all__ = ["DEFAULT", "Flaws", "Level"]

Level = Annotated[
    str, typer.Option(help=f"How far the laboratory departs from what is known about it: {', '.join(LEVELS)}.")
]
Flaws = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=SIZE", help="Give a flaw another size, as registration=1.0mm; may be repeated."),
]
