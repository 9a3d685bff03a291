"""The free parameters of a setup, by name: those that are drawn at random, searched over or fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN, shown, shown_scale
from trocar.tasks.suture.planning.setup import Circle, Needle, NeedleGrasp, SutureSetup, base_beside


@dataclass(frozen=True)
class Range:
    """Bounds of a parameter, inclusive, in m or rad."""

    low: float
    high: float


def _degrees(low: float, high: float) -> Range:
    return Range(math.radians(low), math.radians(high))


RANGES: dict[str, Range] = {
    "center_x_m": Range(-0.010, 0.010),  # shift of the circle's centre along its own x
    "center_y_m": Range(-0.010, 0.010),  # likewise along y
    "circle_radius_m": Range(0.020, 0.040),
    "base_azimuth_rad": _degrees(0, 360),  # direction from the unshifted centre to the base
    "base_sideways_m": Range(0.030, 0.090),  # distance of the base from the circle's axis
    "base_up_m": Range(0.080, 0.150),  # height of the base above the circle
    "base_tilt_rad": _degrees(-60, 60),  # lean of the base towards the circle
    "base_spin_rad": _degrees(-180, 180),  # rotation of the base about its z
    "needle_radius_m": Range(0.006, 0.010),  # radius of the needle's curvature
    "grasp_behind_tip_rad": _degrees(90, 150),  # arc from the needle's tip back to the jaws
    "grasp_approach_rad": _degrees(-180, 180),  # rotation of the jaws about the wire
    "grasp_lean_rad": _degrees(0, 90),  # rotation about the closing direction; below 0 the wrist meets the tissue
    "grasp_skew_rad": _degrees(-180, 180),  # rotation about the jaws' long axis; flat jaws can hold 0 and 180 deg only
}
"""Default bounds, assumed: what fits under an abdominal wall beside a phantom, with needles 17 to 28 mm across."""

MAX_SHIFT_M = 0.5
"""Largest shift of the circle's centre along an axis."""


def parameters_of(setup: SutureSetup) -> dict[str, float]:
    """Return the parameters of a setup; pose of the circle, arm and insertion are not among them."""
    T = setup.T_base_circle.inverse()
    x, y, up = T.translation_m
    azimuth = math.atan2(y, x)
    _, tilt, spin = _facing(T.rotation, azimuth)
    return {
        "center_x_m": 0.0,
        "center_y_m": 0.0,
        "circle_radius_m": setup.circle.radius_m,
        "base_azimuth_rad": azimuth % TURN,
        "base_sideways_m": math.hypot(x, y),
        "base_up_m": float(up),
        "base_tilt_rad": tilt,
        "base_spin_rad": spin,
        "needle_radius_m": setup.needle.radius_m,
        "grasp_behind_tip_rad": setup.grasp.behind_tip_rad,
        "grasp_approach_rad": setup.grasp.approach_rad,
        "grasp_lean_rad": setup.grasp.lean_rad,
        "grasp_skew_rad": setup.grasp.skew_rad,
    }


def with_parameters(setup: SutureSetup, values: Mapping[str, float]) -> SutureSetup:
    """Return the setup with some parameters replaced; the others stay.

    A change of the base's azimuth rotates the whole base about the circle's axis.

    Raises:
        TrocarError: a name is unknown, or no setup has these values.
    """
    check_names(values)
    now = parameters_of(setup)
    new = {**now, **values}
    T_circle_base = setup.T_base_circle.inverse()
    facing, _, _ = _facing(T_circle_base.rotation, now["base_azimuth_rad"])
    facing += new["base_azimuth_rad"] - now["base_azimuth_rad"]
    azimuth, sideways = new["base_azimuth_rad"], new["base_sideways_m"]
    attitude = SO3.axis("z", facing) @ SO3.axis("y", new["base_tilt_rad"]) @ SO3.axis("z", new["base_spin_rad"])
    place = [sideways * math.cos(azimuth), sideways * math.sin(azimuth), new["base_up_m"]]
    shift = SE3.from_parts(translation_m=[new["center_x_m"], new["center_y_m"], 0.0])
    T_world_circle = setup.circle.T_world_circle
    return replace(
        setup,
        T_world_base=T_world_circle @ SE3.from_parts(attitude, place),
        circle=replace(setup.circle, radius_m=new["circle_radius_m"], T_world_circle=T_world_circle @ shift),
        needle=replace(setup.needle, radius_m=new["needle_radius_m"]),
        grasp=replace(
            setup.grasp,
            behind_tip_rad=new["grasp_behind_tip_rad"],
            approach_rad=new["grasp_approach_rad"],
            lean_rad=new["grasp_lean_rad"],
            skew_rad=new["grasp_skew_rad"],
        ),
    )


def check_names(names: Mapping[str, object] | tuple[str, ...]) -> None:
    """Raise TrocarError if a name is not in ``RANGES``."""
    for name in names:
        if name not in RANGES:
            raise TrocarError(f"a setup has no parameter {name!r}; choose one of {', '.join(RANGES)}")


def shown_parameter(name: str) -> tuple[float, str]:
    """Return the factor that takes a parameter to mm or deg, and its name with that unit, as on the command line."""
    stem, _, unit = name.rpartition("_")
    scale, shown_unit = shown_scale(unit)
    return scale, f"{stem}_{shown_unit}"


def check_bounds(name: str, low: float, high: float) -> None:
    """Raise TrocarError unless a parameter can be searched between these bounds."""
    scale, said = shown_parameter(name)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise TrocarError(
            f"{said} is bounded by {scale * low:g} and {scale * high:g}; give two finite numbers, the lower first"
        )
    for end in (low, high):
        _check_value(name, end)


def _check_value(name: str, value: float) -> None:
    """Raise TrocarError if no setup can have this value of a parameter."""
    group, _, field = name.partition("_")
    part: dict[str, Any] = {field: value}
    if group == "circle":
        Circle(**part)
    elif group == "needle":
        Needle(**part)
    elif group == "grasp":
        NeedleGrasp(**part)
    elif group == "base":
        base_beside(**{"azimuth_rad": 0.0, "sideways_m": 0.0, "up_m": 0.0, **part})
    elif abs(value) > MAX_SHIFT_M:
        raise TrocarError(
            f"the shift of the circle's centre is {shown(value, 'm', 'g')}; give {shown(-MAX_SHIFT_M, 'm', 'g')} to "
            f"{shown(MAX_SHIFT_M, 'm', 'g')}"
        )


def _facing(rotation: SO3, azimuth_rad: float) -> tuple[float, float, float]:
    """Return a, b, c of ``Rz(a) Ry(b) Rz(c)`` with a within a quarter turn of the azimuth; b may have either sign."""
    m = rotation.matrix
    b = math.atan2(math.hypot(m[0, 2], m[1, 2]), m[2, 2])
    if b < 1e-9:  # a and c turn about the same axis: only their sum is known
        return azimuth_rad, 0.0, _half_turn(math.atan2(m[1, 0], m[0, 0]) - azimuth_rad)
    a, c = math.atan2(m[1, 2], m[0, 2]), math.atan2(m[2, 1], -m[2, 0])
    if abs(_half_turn(a - azimuth_rad)) > math.pi / 2:
        a, b, c = a + math.pi, -b, c + math.pi
    return a, b, _half_turn(c)


def _half_turn(angle_rad: float) -> float:
    """Return the angle within half a turn of 0."""
    return math.remainder(angle_rad, TURN)
