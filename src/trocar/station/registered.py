"""A station's text with what a registration found."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.station.toml import read_station

EXACT = 1e-9
"""m and rad: what is read back is what was written."""


def with_registered(text: str, T_world_base: Mapping[str, SE3]) -> str:
    """Return a station's TOML text in which the arms' ``registered`` poses are these; all else stays as it is.

    Raises:
        TrocarError: an arm has no table ``[arms.NAME]`` of its own in the text.
    """
    for name, T in T_world_base.items():
        text = _with_line(text, name, f"registered = {_written(T)}")
    station = read_station(text)
    for name, T in T_world_base.items():
        found = station.arm(name).T_world_base_registered
        if found is None or np.abs(found.matrix - T.matrix).max() > EXACT:
            raise TrocarError(f"the registered pose of arm {name!r} could not be written; add it to the file by hand")
    return text


def _written(T: SE3) -> str:
    place = ", ".join(f"{1e3 * value:.9f}" for value in T.translation_m)
    rows = ", ".join("[" + ", ".join(f"{value:.12f}" for value in row) + "]" for row in T.rotation.matrix)
    return f"{{ xyz_mm = [{place}], rotation = [{rows}] }}"


def _with_line(text: str, arm: str, line: str) -> str:
    """Return the text with a line at the head of an arm's table, in place of one of the same key."""
    lines = text.splitlines()
    header = re.compile(rf'\s*\[\s*arms\s*\.\s*["\']?{re.escape(arm)}["\']?\s*\]\s*(#.*)?$')
    heads = [number for number, found in enumerate(lines) if header.match(found)]
    if not heads:
        raise TrocarError(f"the station's file has no table [arms.{arm}]; write the arm as one, then register it again")
    first = heads[0] + 1
    last = next((n for n in range(first, len(lines)) if lines[n].lstrip().startswith("[")), len(lines))
    body = [found for found in lines[first:last] if not re.match(r"\s*registered\s*=", found)]
    return "\n".join([*lines[:first], line, *body, *lines[last:]]) + "\n"
