"""The numbers of a setup that one may choose, by name: what is drawn at random, searched over or fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.sutures.setup import Circle, Needle, NeedleGrasp, SutureSetup, base_beside


@dataclass(frozen=True)
class Range:
    """Bounds of a number, inclusive, and what it is."""

    low: float
    high: float
    about: str


def _degrees(low: float, high: float, about: str) -> Range:
    return Range(math.radians(low), math.radians(high), about)


RANGES: dict[str, Range] = {
    "center_x_m": Range(-0.010, 0.010, "shift of the circle's centre along its own x"),
    "center_y_m": Range(-0.010, 0.010, "shift of the circle's centre along its own y"),
    "circle_radius_m": Range(0.020, 0.040, "radius of the circle"),
    "base_azimuth_rad": _degrees(0, 360, "direction from the unshifted centre to the base"),
    "base_sideways_m": Range(0.030, 0.090, "distance of the base from the circle's axis"),
    "base_up_m": Range(0.080, 0.150, "height of the base over the circle"),
    "base_tilt_rad": _degrees(-60, 60, "lean of the base"),
    "base_spin_rad": _degrees(-180, 180, "turn of the base about its z"),
    "needle_radius_m": Range(0.006, 0.010, "radius of the needle's curvature"),
    "grasp_behind_tip_rad": _degrees(90, 150, "arc from the needle's tip back to the jaws"),
    "grasp_approach_rad": _degrees(-180, 180, "turn of the jaws about the wire"),
    "grasp_lean_rad": _degrees(0, 90, "turn of the jaws about their closing; less puts the wrist into the tissue"),
    "grasp_skew_rad": _degrees(-180, 180, "turn about the jaws' length; the jaws hold flat at 0 and 180 deg alone"),
}
"""Usual bounds, assumed: what fits under an abdominal wall beside a phantom, with needles of 17 to 28 mm across."""

TURNS = ("base_azimuth_rad", "base_spin_rad", "grasp_approach_rad", "grasp_skew_rad")
"""Those that come round after a whole turn."""

MOST_SHIFT_M = 0.5
"""Along an axis, of the circle's centre."""


def parameters_of(setup: SutureSetup) -> dict[str, float]:
    """Return the numbers of a setup; what they leave open (pose of the circle, arm, insertion) is not among them."""
    T = setup.T_base_circle.inverse()
    x, y, up = T.translation_m
    azimuth = math.atan2(y, x)
    _, tilt, spin = _facing(T.rotation, azimuth)
    return {
        "center_x_m": 0.0,
        "center_y_m": 0.0,
        "circle_radius_m": setup.circle.radius_m,
        "base_azimuth_rad": azimuth % (2 * math.pi),
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
    """Return the setup with some numbers replaced; the others stay.

    A base with another azimuth goes round the circle's axis as a whole.

    Raises:
        TrocarError: a name is unknown, or the numbers make no setup.
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
    """Raise a sentence if a name is none of ``RANGES``."""
    for name in names:
        if name not in RANGES:
            raise TrocarError(f"a setup has no parameter {name!r}; choose of {', '.join(RANGES)}")


def shown(name: str) -> tuple[float, str]:
    """Return what a number is multiplied by to be shown in mm or deg, and its name then, as on the command line."""
    stem, _, unit = name.rpartition("_")
    return (1e3, f"{stem}_mm") if unit == "m" else (math.degrees(1.0), f"{stem}_deg")


def check_bounds(name: str, low: float, high: float) -> None:
    """Raise a sentence unless a number of a setup can be searched between these bounds."""
    scale, said = shown(name)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise TrocarError(
            f"{said} is bounded by {scale * low:g} and {scale * high:g}; give two finite numbers, the lower first"
        )
    for end in (low, high):
        _check_value(name, end)


def _check_value(name: str, value: float) -> None:
    """Raise a sentence if no setup has this number."""
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
    elif abs(value) > MOST_SHIFT_M:
        raise TrocarError(
            f"the shift of the circle's centre is {1e3 * value:g} mm; give {-1e3 * MOST_SHIFT_M:g} to "
            f"{1e3 * MOST_SHIFT_M:g} mm"
        )


def _facing(rotation: SO3, azimuth_rad: float) -> tuple[float, float, float]:
    """Return a, b, c of ``Rz(a) Ry(b) Rz(c)`` with a within a quarter turn of the azimuth; b takes either sign."""
    m = rotation.matrix
    b = math.atan2(math.hypot(m[0, 2], m[1, 2]), m[2, 2])
    if b < 1e-9:  # a and c cannot be told apart
        return azimuth_rad, 0.0, _half_turn(math.atan2(m[1, 0], m[0, 0]) - azimuth_rad)
    a, c = math.atan2(m[1, 2], m[0, 2]), math.atan2(m[2, 1], -m[2, 0])
    if abs(_half_turn(a - azimuth_rad)) > math.pi / 2:
        a, b, c = a + math.pi, -b, c + math.pi
    return a, b, _half_turn(c)


def _half_turn(angle_rad: float) -> float:
    """Return the angle within half a turn of 0."""
    return math.remainder(angle_rad, 2 * math.pi)
