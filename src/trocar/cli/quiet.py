"""``--quiet``: nothing but errors and the last lines of a result; for the whole line, wherever in it it stands."""

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
    """Leave them out from now on, or not."""
    _QUIET.set(wanted)


def _heard(wanted: bool) -> None:
    """Be quiet where it is asked for; not being asked takes nothing back."""
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
    """Return the option as a parameter that a command can be given after it was made."""
    app = typer.Typer(rich_markup_mode=None, add_completion=False)

    @app.command()
    def donor(quiet: Quiet = False) -> None:
        del quiet

    return get_command(app).params[0]
