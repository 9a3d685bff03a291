"""Where text is printed, and what ``--quiet`` leaves out."""

from __future__ import annotations

from rich.console import Console

from trocar.cli.quiet import is_quiet


def results() -> Console:
    """Return the console for the requested result, which is always printed."""
    return Console()


def details() -> Console:
    """Return the console for what precedes the end of a long result: tables, remarks; silent with ``--quiet``."""
    return Console(quiet=is_quiet())


def beside() -> Console:
    """Return the console for messages beside the result, on stderr; silent with ``--quiet``."""
    return Console(stderr=True, quiet=is_quiet())
