"""The numbers of a setup by name: options of ``plan suture``, and what ``plan setup`` searches over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import SE3, SO3, TURN, shown, shown_scale
from trocar.tasks.suture.planning.setup import SutureSetup, base_beside

MAX_SHIFT_M = 0.5
"""Largest shift of the circle's centre along an axis."""


@dataclass(frozen=True)
class Parameter:
    """One number of a setup, in m or rad.

    Attributes:
        part: attribute of the setup that holds it, or ``base``, or ``center``.
        field: its name there; of ``base`` an argument of ``base_beside``.
        about: one line for the help.
        bounds: between which it is searched by default, assumed: what fits under an abdominal wall beside a phantom,
            with needles 17 to 28 mm across. None: it is not searched over.
    """

    part: str
    field: str
    about: str
    bounds: tuple[float, float] | None = None


def _degrees(low: float, high: float) -> tuple[float, float]:
    return math.radians(low), math.radians(high)


PARAMETERS: dict[str, Parameter] = {
    "center_x_m": Parameter("center", "x_m", "Shift of the circle's centre along its own x.", (-0.010, 0.010)),
    "center_y_m": Parameter("center", "y_m", "Shift of the circle's centre along its own y.", (-0.010, 0.010)),
    "circle_radius_m": Parameter("circle", "radius_m", "Radius of the circle of sutures.", (0.020, 0.040)),
    "base_azimuth_rad": Parameter(
        "base", "azimuth_rad", "Direction of the arm's base, counterclockwise from x.", _degrees(0, 360)
    ),
    "base_sideways_m": Parameter(
        "base", "sideways_m", "Horizontal distance of the base from the world's origin.", (0.030, 0.090)
    ),
    "base_up_m": Parameter("base", "up_m", "Height of the base.", (0.080, 0.150)),
    "base_tilt_rad": Parameter(
        "base", "tilt_rad", "Lean of the resting instrument towards the origin.", _degrees(-60, 60)
    ),
    "base_spin_rad": Parameter("base", "spin_rad", "Rotation of the base about its z.", _degrees(-180, 180)),
    "needle_radius_m": Parameter("needle", "radius_m", "Radius of the needle's curvature.", (0.006, 0.010)),
    "needle_arc_rad": Parameter("needle", "arc_rad", "Arc of the needle from tip to tail."),
    "grasp_behind_tip_rad": Parameter(
        "grasp", "behind_tip_rad", "Arc from the needle's tip back to the jaws.", _degrees(90, 150)
    ),
    "grasp_approach_rad": Parameter(
        "grasp", "approach_rad", "Rotation of the jaws about the wire.", _degrees(-180, 180)
    ),
    # below 0 the wrist meets the tissue
    "grasp_lean_rad": Parameter(
        "grasp", "lean_rad", "Rotation of the jaws about their closing direction.", _degrees(0, 90)
    ),
    # flat jaws can hold 0 and 180 deg only
    "grasp_skew_rad": Parameter(
        "grasp", "skew_rad", "Rotation of the jaws about their long axis.", _degrees(-180, 180)
    ),
    "entry_angle_rad": Parameter("insertion", "entry_angle_rad", "Angle between the entering needle and the surface."),
    "straight_m": Parameter("insertion", "straight_m", "Length of the straight penetration."),
    "rotation_rad": Parameter("insertion", "rotation_rad", "Rotation about the needle's centre that follows."),
    "regrasp_rad": Parameter("insertion", "regrasp_rad", "How far the jaws move back along the needle."),
}

SEARCHED = tuple(name for name, parameter in PARAMETERS.items() if parameter.bounds)
"""Names of the parameters that can be searched over."""


def parameters_of(setup: SutureSetup) -> dict[str, float]:
    """Return the parameters of a setup; the centre's shift is 0, whatever the pose of the circle."""
    base = _base_numbers(setup.T_world_base)
    base["azimuth_rad"] %= TURN
    made_up = {"base": base, "center": {"x_m": 0.0, "y_m": 0.0}}
    return {
        name: made_up[of.part][of.field] if of.part in made_up else getattr(getattr(setup, of.part), of.field)
        for name, of in PARAMETERS.items()
    }


def with_parameters(setup: SutureSetup, values: Mapping[str, float], **changes: Any) -> SutureSetup:
    """Return the setup with some parameters replaced; the others stay.

    Args:
        setup: where the others come from.
        values: of parameters, by name.
        changes: parts of the setup that are replaced first.

    Raises:
        InvalidInput: a name is unknown, or no setup has these values.
    """
    parts: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        if name not in PARAMETERS:
            raise UnknownName("the parameter of a setup", name, PARAMETERS)
        parts.setdefault(PARAMETERS[name].part, {})[PARAMETERS[name].field] = value
    base, center = parts.pop("base", {}), parts.pop("center", {})
    changes |= {part: replace(changes.get(part, getattr(setup, part)), **fields) for part, fields in parts.items()}
    if base:
        now = _base_numbers(setup.T_world_base)
        changes["T_world_base"] = base_beside(**{**now, **base})
        rest = base_beside(**now).inverse() @ setup.T_world_base
        if not np.allclose(rest.matrix, np.eye(4), rtol=0.0, atol=1e-12):  # its attitude needs more than two angles
            changes["T_world_base"] @= rest
    if center:
        circle = changes.get("circle", setup.circle)
        shift = SE3.from_parts(translation_m=[center.get("x_m", 0.0), center.get("y_m", 0.0), 0.0])
        changes["circle"] = replace(circle, T_world_circle=circle.T_world_circle @ shift)
    return replace(setup, **changes)


def _base_numbers(T_world_base: SE3) -> dict[str, float]:
    """Return the arguments of ``base_beside`` that give this base."""
    x, y, up = T_world_base.translation_m.tolist()
    azimuth = math.atan2(y, x)
    leaning = (SO3.axis("z", -azimuth) @ T_world_base.rotation).matrix
    return {
        "azimuth_rad": azimuth,
        "sideways_m": math.hypot(x, y),
        "up_m": up,
        "tilt_rad": math.atan2(leaning[0, 2], leaning[2, 2]),
        "spin_rad": math.atan2(leaning[1, 0], leaning[1, 1]),
    }


def shown_parameter(name: str) -> tuple[float, str]:
    """Return the factor that takes a parameter to mm or deg, and its name with that unit, as on the command line."""
    stem, _, unit = name.rpartition("_")
    scale, shown_unit = shown_scale(unit)
    return scale, f"{stem}_{shown_unit}"


def check_bounds(setup: SutureSetup, name: str, low: float, high: float) -> None:
    """Raise InvalidInput unless a parameter of this setup can be searched between these bounds."""
    scale, said = shown_parameter(name)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InvalidInput(
            said, f"is bounded by {scale * low:g} and {scale * high:g}", "give two finite numbers, the lower first"
        )
    parameter = PARAMETERS[name]
    for end in (low, high):
        if parameter.part == "base":
            with_parameters(setup, {name: end})
        elif parameter.part != "center":
            replace(getattr(setup, parameter.part), **{parameter.field: end})
        elif abs(end) > MAX_SHIFT_M:
            limits = f"{shown(-MAX_SHIFT_M, 'm', 'g')} to {shown(MAX_SHIFT_M, 'm', 'g')}"
            raise InvalidValue("the shift of the circle's centre", shown(end, "m", "g"), f"give {limits}")
