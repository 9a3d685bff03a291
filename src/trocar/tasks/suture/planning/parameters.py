"""The numbers of a setup by name: what ``--set`` and setup files change, and what ``plan setup`` searches over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from trocar.errors import UnknownName
from trocar.geometry import SE3, SO3, TURN, shown_scale
from trocar.tasks.suture.needle import check_range
from trocar.tasks.suture.planning.setup import SutureSetup, base_beside

MAX_SHIFT_M = 0.5
"""Largest shift of the circle's centre along an axis."""


class Parameter(NamedTuple):
    """One number of a setup, in m or rad.

    Attributes:
        about: one line for the help.
        bounds: bounds of a search by default. They are assumed: what fits under an abdominal wall beside a phantom,
            with needles 12 to 20 mm across. None: not searched over.
    """

    about: str
    bounds: tuple[float, float] | None = None


def _degrees(low: float, high: float) -> tuple[float, float]:
    return math.radians(low), math.radians(high)


PARAMETERS = {
    "center_x_m": Parameter("Shift of the circle's centre along its own x.", (-0.010, 0.010)),
    "center_y_m": Parameter("Shift of the circle's centre along its own y.", (-0.010, 0.010)),
    "center_z_m": Parameter("Shift of the circle's centre out of the tissue."),
    "circle_radius_m": Parameter("Radius of the circle of sutures.", (0.020, 0.040)),
    "circle_mesh_beyond_m": Parameter("How far the mesh's edge lies outside of the circle."),
    "circle_mesh_margin_m": Parameter("How far bites stay from the mesh's edge."),
    "circle_defect_within_m": Parameter("How far the defect's edge lies inside of the circle."),
    "base_azimuth_rad": Parameter("Direction of the arm's base, counterclockwise from x.", _degrees(0, 360)),
    "base_sideways_m": Parameter("Horizontal distance of the base from the world's origin.", (0.030, 0.090)),
    "base_up_m": Parameter("Height of the base.", (0.080, 0.150)),
    "base_tilt_rad": Parameter("Lean of the resting instrument towards the origin.", _degrees(-60, 60)),
    "base_spin_rad": Parameter("Rotation of the base about its z.", _degrees(-180, 180)),
    "needle_radius_m": Parameter("Radius of the needle's curvature.", (0.006, 0.010)),
    "needle_arc_rad": Parameter("Arc of the needle from tip to tail."),
    "grasp_behind_tip_rad": Parameter("Arc from the needle's tip back to the jaws.", _degrees(90, 150)),
    "grasp_approach_rad": Parameter("Rotation of the jaws about the wire.", _degrees(-180, 180)),
    # below 0, the wrist meets the tissue
    "grasp_lean_rad": Parameter("Rotation of the jaws about their closing direction.", _degrees(0, 90)),
    # flat jaws can hold the wire at 0 and 180 deg only
    "grasp_skew_rad": Parameter("Rotation of the jaws about their long axis.", _degrees(-180, 180)),
    "wall_up_m": Parameter("Height of the body wall's inner surface above the world's origin; 0: no wall."),
    "wall_thick_m": Parameter("Thickness of the body wall, in which ports lie."),
    "wall_slope_rad": Parameter("Slope of the body wall."),
    "wall_azimuth_rad": Parameter("Direction in which the body wall rises, counterclockwise from x."),
    "puller_azimuth_rad": Parameter("Direction of the second arm's port.", _degrees(0, 360)),
    "puller_sideways_m": Parameter("Horizontal distance of the second arm's port.", (0.030, 0.150)),
    "puller_up_m": Parameter("Height of the second arm's port; 0: no second arm.", (0.080, 0.150)),
    "insertion_straight_m": Parameter("How far the needle goes in straight before it turns."),
    "insertion_regrasp_rad": Parameter("How far the jaws move back along the needle."),
}
"""Numbers of a setup by name: the part of the setup (``center`` and ``base`` are poses), then the field there."""
SEARCHED = {name: parameter.bounds for name, parameter in PARAMETERS.items() if parameter.bounds}
"""The parameters that can be searched over, with their usual bounds."""


def parameters_of(setup: SutureSetup) -> dict[str, float]:
    """Return the parameters of a setup; the centre's shift is 0, whatever the pose of the circle."""
    base = _base_numbers(setup.T_world_base)
    found = {f"center_{axis}_m": 0.0 for axis in "xyz"} | {f"base_{name}": value for name, value in base.items()}
    found["base_azimuth_rad"] %= TURN
    parts = {name: name.split("_", 1) for name in PARAMETERS}
    return {name: found[name] if name in found else getattr(getattr(setup, a), b) for name, (a, b) in parts.items()}


def with_parameters(setup: SutureSetup, values: Mapping[str, float], **changes: Any) -> SutureSetup:
    """Return the setup with some parts replaced, then some parameters by name; the others stay.

    Raises:
        InvalidInput: a name is unknown, or no setup has these values.
    """
    parts: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        if name not in PARAMETERS:
            raise UnknownName("the parameter of a setup", name, PARAMETERS)
        part, number = name.split("_", 1)
        parts.setdefault(part, {})[number] = value
    base, center = parts.pop("base", {}), parts.pop("center", {})
    changes |= {part: replace(changes.get(part, getattr(setup, part)), **fields) for part, fields in parts.items()}
    if base:
        now = _base_numbers(setup.T_world_base)
        changes["T_world_base"] = base_beside(**{**now, **base})
        rest = base_beside(**now).inverse() @ setup.T_world_base
        if not np.allclose(rest.matrix, np.eye(4), rtol=0.0, atol=1e-12):  # two angles do not give its attitude
            changes["T_world_base"] @= rest
    if center:
        circle = changes.get("circle", setup.circle)
        for value in center.values():
            check_range("shift of the circle's centre", value, -MAX_SHIFT_M, MAX_SHIFT_M)
        shift = SE3.from_parts(translation_m=[center.get(f"{axis}_m", 0.0) for axis in "xyz"])
        changes["circle"] = replace(circle, T_world_circle=circle.T_world_circle @ shift)
    return replace(setup, **changes)


def _base_numbers(T_world_base: SE3) -> dict[str, float]:
    """Return the arguments of ``base_beside`` that give this base."""
    x, y, up = T_world_base.translation_m.tolist()
    azimuth = math.atan2(y, x)
    leaning = (SO3.axis("z", -azimuth) @ T_world_base.rotation).matrix
    tilt, spin = math.atan2(leaning[0, 2], leaning[2, 2]), math.atan2(leaning[1, 0], leaning[1, 1])
    return {"azimuth_rad": azimuth, "sideways_m": math.hypot(x, y), "up_m": up, "tilt_rad": tilt, "spin_rad": spin}


def shown_parameter(name: str) -> tuple[float, str]:
    """Return the factor that takes a parameter to mm or deg, and its name with that unit, as on the command line."""
    stem, _, unit = name.rpartition("_")
    scale, shown_unit = shown_scale(unit)
    return scale, f"{stem.removeprefix('insertion_')}_{shown_unit}"


SAID = {shown_parameter(name)[1]: name for name in PARAMETERS}
"""Names of the parameters by their names on the command line, in mm or deg: ``base_tilt_deg``, ``regrasp_deg``."""
