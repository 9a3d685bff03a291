"""``--difficulty LEVEL`` and ``--flaw NAME=SIZE``: how far a simulated laboratory is from what is known of it."""

from __future__ import annotations

from typing import Annotated

import typer

Level = Annotated[str, typer.Option(help="How far the laboratory is from what is known of it: mild, recorded, harsh.")]
Flaws = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=SIZE", help="Give a flaw another size, as registration=1.0mm; may be repeated."),
]
