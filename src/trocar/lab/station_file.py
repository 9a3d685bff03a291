"""Station files in TOML: find them by name or path, read them, and add registered poses to them."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from trocar.errors import BadFile, InvalidInput, UnknownName
from trocar.geometry import SE3
from trocar.lab.station import Station
from trocar.lab.topics import Topics
from trocar.perception.image import CameraModel, Intrinsics, StereoRig

EXACT = 1e-9
"""Greatest difference between a pose's matrix (rotation, m) that was written and the one that is read back."""


def built_in_stations() -> tuple[str, ...]:
    """Return the names of the stations that come with the package."""
    folder = files("trocar.lab") / "stations"
    return tuple(sorted(path.name.removesuffix(".toml") for path in folder.iterdir() if path.name.endswith(".toml")))


def load_station(name_or_path: str | Path) -> Station:
    """Return a built-in station by its name, or the one in a TOML file.

    Raises:
        InvalidInput: there is no such station, or its file describes an impossible one.

    Example:
        >>> load_station("peg-transfer").arms["psm1"].model.name
        'psm-classic'
    """
    return read_station(*_text(name_or_path))


def station_text(name_or_path: str | Path) -> str:
    """Return the TOML text of a station."""
    return _text(name_or_path)[0]


def station_digest(name_or_path: str | Path) -> str:
    """Return a hash of a station's text, which shows whether it is still the one that a run was made with."""
    return hashlib.sha256(station_text(name_or_path).encode()).hexdigest()[:16]


def _text(name_or_path: str | Path) -> tuple[str, str]:
    """Return the text of a station, and its name in error messages."""
    known = built_in_stations()
    if str(name_or_path) in known:
        text = (files("trocar.lab") / "stations" / f"{name_or_path}.toml").read_text(encoding="utf-8")
        return text, f"built-in station {str(name_or_path)!r}"
    path = Path(name_or_path)
    if path.suffix != ".toml":
        remedy = f"choose one of {', '.join(known)}, or give a .toml file"
        raise UnknownName("station", str(path), known, remedy=remedy)
    try:
        return path.read_text(encoding="utf-8"), f"station file {str(path)!r}"
    except FileNotFoundError:
        remedy = f"give another, or one of {', '.join(known)}"
        raise BadFile(path, "does not exist", remedy, kind="station file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(path, f"cannot be read ({error})", "give a TOML file in UTF-8", kind="station file") from None


def read_station(text: str, where: str = "the station") -> Station:
    """Return the station that a TOML text describes; ``where`` is its name in error messages."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidInput(where, f"is not TOML: {error}", "correct that line") from None
    from trocar.lab.station_schema import station_of  # pydantic is slow to import

    return station_of(values, where)


def with_registered(
    text: str, T_world_base: Mapping[str, SE3], cameras: Mapping[str, tuple[SE3, CameraModel]] | None = None
) -> str:
    """Return a station's TOML text with these ``registered`` poses; everything else stays as it is.

    Args:
        text: TOML text of the station.
        T_world_base: poses of the bases, by arm.
        cameras: pose in the world and model, by camera; only the lenses of stereo pairs are written.

    Raises:
        InvalidInput: an arm or a camera has no table ``[arms.NAME]`` or ``[cameras.NAME]`` in the text.
    """
    cameras = cameras or {}
    for name, T in T_world_base.items():
        text = _with_line(text, "arms", name, f"registered = {_pose(T)}")
    for name, (T, model) in cameras.items():
        lenses = f", {_lenses(model)}" if isinstance(model, StereoRig) else ""
        text = _with_line(text, "cameras", name, f"registered = {{ pose = {_pose(T)}{lenses} }}")
    station = read_station(text)
    for name, T in T_world_base.items():
        _require_same(f"arm {name!r}", station.arm(name).T_world_base_registered, T)
    for name, (T, model) in cameras.items():
        found = station.cameras[name]
        _require_same(f"camera {name!r}", found.T_world_camera_registered, T)
        if isinstance(model, StereoRig):
            rig = found.rig_registered
            _require_same(f"camera {name!r}", rig and rig.T_left_right, model.T_left_right)
    return text


def with_topics(text: str, topics: Topics) -> str:
    """Return a station's TOML text with these topics as its table ``[crtk]``."""
    values = {one.name: getattr(topics, one.name) for one in fields(topics)}
    lines = [f"{name} = {_toml(value)}" for name, value in values.items() if value not in (None, (), {})]
    kept, inside = [], False
    for line in text.splitlines():
        if line.lstrip().startswith("["):
            inside = re.match(r"\s*\[\s*crtk\s*[.\]]", line) is not None
        kept += [] if inside else [line]
    text = "\n".join(["\n".join(kept).rstrip(), "", "[crtk]", *lines]) + "\n"
    if read_station(text).crtk != topics:
        raise InvalidInput("the table [crtk] of the station's file", "could not be written", "add it by hand")
    return text


def _toml(value: Any) -> str:
    """Return a value in TOML; strings, numbers and lists look as in JSON."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{json.dumps(name)} = {_toml(one)}' for name, one in value.items())} }}"
    return json.dumps(value.value if isinstance(value, Enum) else value)


def _require_same(what: str, found: SE3 | None, written: SE3) -> None:
    if found is None or np.abs(found.matrix - written.matrix).max() > EXACT:
        raise InvalidInput(f"the registered pose of {what}", "could not be written", "add it to the file by hand")


def _pose(T: SE3) -> str:
    rows = ", ".join(_numbers(row, 12) for row in T.rotation.matrix)
    return f"{{ xyz_mm = {_numbers(1e3 * T.translation_m, 9)}, rotation = [{rows}] }}"


def _lenses(rig: StereoRig) -> str:
    return f"left = {_lens(rig.left)}, right = {_lens(rig.right)}, right_pose = {_pose(rig.T_left_right)}"


def _lens(lens: Intrinsics) -> str:
    return (
        f"{{ size_px = [{lens.width}, {lens.height}], focal_px = {_numbers((lens.fx, lens.fy), 9)}, "
        f"centre_px = {_numbers((lens.cx, lens.cy), 9)}, distortion = {_numbers(lens.distortion, 12)} }}"
    )


def _numbers(values: Iterable[float], digits: int) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"


def _with_line(text: str, group: str, name: str, line: str) -> str:
    """Return the text with a ``registered`` line at the head of the table [group.name], replacing an older one."""
    lines = text.splitlines()
    header = re.compile(rf'\s*\[\s*{group}\s*\.\s*["\']?{re.escape(name)}["\']?\s*\]\s*(#.*)?$')
    heads = [number for number, found in enumerate(lines) if header.match(found)]
    if not heads:
        raise InvalidInput(
            "the station's file", f"has no table [{group}.{name}]", f"write {name!r} as one, then register it again"
        )
    first = heads[0] + 1
    last = next((n for n in range(first, len(lines)) if lines[n].lstrip().startswith("[")), len(lines))
    body = [found for found in lines[first:last] if not re.match(r"\s*registered\s*=", found)]
    return "\n".join([*lines[:first], line, *body, *lines[last:]]) + "\n"
