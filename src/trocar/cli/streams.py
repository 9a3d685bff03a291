"""Makes sure, before anything is printed, that stdout and stderr can show it."""

from __future__ import annotations

import os
import sys
from io import TextIOWrapper

MIN_COLUMNS, MAX_COLUMNS = 20, 1000
"""Plausible widths of a terminal; a value outside them counts as not given, as with COLUMNS=0."""


def prepare_streams() -> None:
    """Make any text printable anywhere: characters that an encoding lacks are written as escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns and not (columns.isascii() and columns.isdigit() and MIN_COLUMNS <= int(columns[:9]) <= MAX_COLUMNS):
        del os.environ["COLUMNS"]
