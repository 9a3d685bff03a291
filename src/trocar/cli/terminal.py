"""What is printed where, and what is left out with ``--quiet``."""

from __future__ import annotations

from rich.console import Console

from trocar.cli.quiet import is_quiet


def results() -> Console:
    """Return the console of what was asked for: it is always printed."""
    return Console()


def details() -> Console:
    """Return the console of what leads to the end of a long result: tables and remarks; silent with ``--quiet``."""
    return Console(quiet=is_quiet())


def beside() -> Console:
    """Return the console of what is said beside the result, on stderr; silent with ``--quiet``."""
    return Console(stderr=True, quiet=is_quiet())
