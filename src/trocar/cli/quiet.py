"""``--quiet``: only errors and the last lines of a result; it holds for the whole line, wherever it is given."""

from __future__ import annotations

from contextvars import ContextVar
from functools import cache
from typing import Annotated, Any

import typer
from typer.main import get_command

_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


def is_quiet() -> bool:
    """Return whether progress, tables and remarks are left out."""
    return _QUIET.get()


def be_quiet(wanted: bool) -> None:
    """Leave them out from now on, or show them again."""
    _QUIET.set(wanted)


def _heard(wanted: bool) -> None:
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
        callback=_heard,
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
