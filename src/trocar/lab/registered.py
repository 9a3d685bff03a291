"""The text of a station file with the results of a registration."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.lab.toml import read_station
from trocar.perception.image import Intrinsics, StereoRig

EXACT = 1e-9
"""m and rad: values read back are those that were written."""


def with_registered(
    text: str, T_world_base: Mapping[str, SE3], cameras: Mapping[str, tuple[SE3, StereoRig]] | None = None
) -> str:
    """Return a station's TOML text with these ``registered`` poses; everything else stays as it is.

    Args:
        text: of the station.
        T_world_base: bases, by arm.
        cameras: pose in the world and lenses of stereo pairs, by camera.

    Raises:
        TrocarError: an arm or a camera has no separate table ``[arms.NAME]``, ``[cameras.NAME]`` in the text.
    """
    cameras = cameras or {}
    for name, T in T_world_base.items():
        text = _with_line(text, "arms", name, f"registered = {_pose(T)}")
    for name, (T, rig) in cameras.items():
        text = _with_line(text, "cameras", name, f"registered = {{ pose = {_pose(T)}, {_lenses(rig)} }}")
    station = read_station(text)
    for name, T in T_world_base.items():
        _require_same(f"arm {name!r}", station.arm(name).T_world_base_registered, T)
    for name, (T, rig) in cameras.items():
        found = station.cameras[name]
        _require_same(f"camera {name!r}", found.T_world_camera_registered, T)
        _require_same(f"camera {name!r}", found.rig_registered and found.rig_registered.T_left_right, rig.T_left_right)
    return text


def _require_same(what: str, found: SE3 | None, written: SE3) -> None:
    if found is None or np.abs(found.matrix - written.matrix).max() > EXACT:
        raise TrocarError(f"the registered pose of {what} could not be written; add it to the file by hand")


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
    """Return the text with a line at the head of the table [group.name], replacing any line with the same key."""
    lines = text.splitlines()
    header = re.compile(rf'\s*\[\s*{group}\s*\.\s*["\']?{re.escape(name)}["\']?\s*\]\s*(#.*)?$')
    heads = [number for number, found in enumerate(lines) if header.match(found)]
    if not heads:
        raise TrocarError(
            f"the station's file has no table [{group}.{name}]; write {name!r} as one, then register it again"
        )
    first = heads[0] + 1
    last = next((n for n in range(first, len(lines)) if lines[n].lstrip().startswith("[")), len(lines))
    body = [found for found in lines[first:last] if not re.match(r"\s*registered\s*=", found)]
    return "\n".join([*lines[:first], line, *body, *lines[last:]]) + "\n"
