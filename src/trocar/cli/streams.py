"""What stdout and stderr can show: made sure of before anything is printed."""

from __future__ import annotations

import os
import sys
from io import TextIOWrapper

MIN_COLUMNS, MAX_COLUMNS = 20, 1000
"""Of a terminal; one that claims less or more is taken to say nothing, as where COLUMNS is 0."""


def prepare_streams() -> None:
    """Let any text be printed anywhere: what an encoding lacks is written as an escape."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns and not (columns.isascii() and columns.isdigit() and MIN_COLUMNS <= int(columns[:9]) <= MAX_COLUMNS):
        del os.environ["COLUMNS"]
