"""Where text is printed, what ``--quiet`` leaves out, and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


def be_quiet(wanted: bool) -> None:
    """Leave progress, tables and remarks out from now on, or show them again."""
    _QUIET.set(wanted)


def results() -> Console:
    """Return the console for the requested result, which is always printed."""
    return _console(to_stderr=False, quiet=False)


def details() -> Console:
    """Return the console for what precedes the end of a long result: tables, remarks; silent with ``--quiet``."""
    return _console(to_stderr=False, quiet=_QUIET.get())


def beside() -> Console:
    """Return the console for messages beside the result, on stderr; silent with ``--quiet``."""
    return _console(to_stderr=True, quiet=_QUIET.get())


def _console(to_stderr: bool, quiet: bool) -> Console:
    from rich.console import Console  # not needed to list commands

    return Console(stderr=to_stderr, quiet=quiet, markup=False)  # brackets in paths and reasons are text


def rich_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", *, text: int = 0
) -> Table:
    """Return a table whose first ``text`` columns are text, and the others numbers; an empty row draws a line."""
    from rich.table import Table  # not needed to list commands

    table = Table(title=title, caption=caption or None)
    for number, column in enumerate(columns):
        word = number < text
        table.add_column(column, justify="left" if word else "right", no_wrap=not word and " " not in column)
    for row in rows:
        if row:
            table.add_row(*row)
        else:
            table.add_section()
    return table
