"""The options of the suture commands, in degrees and mm, and the setup, reward and spacing that they make."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.sutures import MARGINS, PRESETS, Circle, Preset, Reward, SutureSetup, base_beside
from trocar.sutures.plan import Spacing
from trocar.sutures.rewards import JOINTS, SCALINGS

if TYPE_CHECKING:
    from trocar.sutures.demonstrations import Demonstrations

T = TypeVar("T")

REWARD, SPACING, GIVEN = "What is good", "Where sutures may stand", "Arm, circle, needle (default: the preset's)"


def option(group: str, help: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Return a documented option of a group."""
    return typer.Option(*([name] if name else []), help=help, metavar=metavar, rich_help_panel=group)


PresetName = Annotated[str, typer.Option("--preset", help=f"Setup and reward to start from: {', '.join(PRESETS)}.")]
DemonstrationsPath = Annotated[
    str | None,
    option(
        REWARD,
        "Recorded sutures for the manipulability (manifest, or its folder), or `synthetic`.",
        "PATH",
        "--demonstrations",
    ),
]
Margin = Annotated[str | None, option(REWARD, f"Formula of the joint margin: {', '.join(MARGINS)}.")]
Weight = Annotated[float | None, option(REWARD, "lambda, the share of the margin; the rest is manipulability.")]
Scaling = Annotated[
    str | None, option(REWARD, f"How margin and manipulability become comparable: {', '.join(SCALINGS)}.")
]
Joints = Annotated[str | None, option(REWARD, f"Joints that the margin looks at: {', '.join(JOINTS)}.")]
At = Annotated[str | None, option(REWARD, "Where it looks: stations (start and end of movements) or path.")]
FeasibleFirst = Annotated[
    bool | None,
    typer.Option(
        "--feasible-first/--reward-first",
        help="Take a direction beyond the limits only where there is no other, or by its reward alone.",
        rich_help_panel=REWARD,
    ),
]
ArmName = Annotated[str | None, option(GIVEN, f"Who sutures: {', '.join(ARMS)}.", name="--arm")]
CircleRadius = Annotated[float | None, option(GIVEN, "Radius of the circle of sutures.", "MM")]
Center = Annotated[
    tuple[float, float, float] | None, option(GIVEN, "Centre of the circle in the world.", "X Y Z", "--center-mm")
]
Normal = Annotated[
    tuple[float, float, float] | None,
    option(GIVEN, "Direction out of the tissue; theta then starts near the world's x.", "X Y Z"),
]
BaseAzimuth = Annotated[float | None, option(GIVEN, "Where the base stands, counterclockwise from x.", "DEG")]
BaseSideways = Annotated[float | None, option(GIVEN, "Its horizontal distance from the world's origin.", "MM")]
BaseUp = Annotated[float | None, option(GIVEN, "Its height.", "MM")]
BaseTilt = Annotated[float | None, option(GIVEN, "Lean of the resting instrument towards the origin.", "DEG")]
BaseSpin = Annotated[float | None, option(GIVEN, "Turn of the base about its z.", "DEG")]
NeedleRadius = Annotated[float | None, option(GIVEN, "Radius of the needle's curvature.", "MM")]
NeedleArc = Annotated[float | None, option(GIVEN, "Arc of the needle from tip to tail.", "DEG")]
BehindTip = Annotated[
    float | None, option(GIVEN, "Arc from the needle's tip back to the jaws.", "DEG", "--grasp-behind-tip-deg")
]
Approach = Annotated[float | None, option(GIVEN, "Turn of the jaws about the wire.", "DEG", "--grasp-approach-deg")]
Lean = Annotated[float | None, option(GIVEN, "Turn about the way in which they close.", "DEG", "--grasp-lean-deg")]
Skew = Annotated[float | None, option(GIVEN, "Turn about the jaws' length.", "DEG", "--grasp-skew-deg")]
EntryAngle = Annotated[float | None, option(GIVEN, "Angle of the needle's entry to the surface.", "DEG")]
Straight = Annotated[float | None, option(GIVEN, "Length of the straight penetration.", "MM", "--straight-mm")]
Rotation = Annotated[float | None, option(GIVEN, "Turn about the needle's centre after it.", "DEG", "--rotation-deg")]
Regrasp = Annotated[float | None, option(GIVEN, "How far the jaws go back along the needle.", "DEG", "--regrasp-deg")]
Pushes = Annotated[int | None, option(GIVEN, "How often they do so and push it on.")]
ThetaIs = Annotated[str | None, option(GIVEN, "Which point of a suture stands at theta: entry or middle.")]


def chosen(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise with the names there are."""
    if name not in table:
        raise TrocarError(f"no {what} is called '{name}'; choose one of: {', '.join(table)}")
    return table[name]


def recorded(demonstrations: str | None) -> Demonstrations | None:
    """Return the demonstrations that were given."""
    if demonstrations is None:
        return None
    from trocar.sutures.demonstrations import load_demonstrations, synthetic_demonstrations  # noqa: PLC0415

    return synthetic_demonstrations() if demonstrations == "synthetic" else load_demonstrations(demonstrations)


def changed_reward(preset: Preset, **fields: Any) -> Reward:
    """Return the preset's reward with what was given on the command line; None is not given."""
    return replace(preset.reward, **given(fields))


def changed_setup(
    preset: Preset,
    *,
    arm: str | None = None,
    center_mm: Sequence[float] | None = None,
    normal: Sequence[float] | None = None,
    circle: Mapping[str, Any],
    base: Mapping[str, Any],
    needle: Mapping[str, Any],
    grasp: Mapping[str, Any],
    insertion: Mapping[str, Any],
) -> SutureSetup:
    """Return the preset's setup with what was given on the command line; None is not given.

    Args:
        preset: where to start.
        arm: name of another arm.
        center_mm: of the circle.
        normal: of the tissue.
        circle: fields of ``Circle``.
        base: arguments of ``base_beside``.
        needle: fields of ``Needle``.
        grasp: fields of ``NeedleGrasp``.
        insertion: fields of ``Insertion``.
    """
    setup = preset.setup
    changes: dict[str, Any] = {
        "needle": replace(setup.needle, **given(needle)),
        "grasp": replace(setup.grasp, **given(grasp)),
        "insertion": replace(setup.insertion, **given(insertion)),
        "circle": _circle(setup.circle, center_mm, normal, given(circle)),
    }
    if arm is not None:
        changes["arm"] = chosen(ARMS, arm, "arm")
    if given(base):
        changes["T_world_base"] = base_beside(**{**base_numbers(setup.T_world_base), **given(base)})
    return replace(setup, **changes)


def base_numbers(T_world_base: SE3) -> dict[str, float]:
    """Return the arguments of ``base_beside`` that make this base."""
    place = T_world_base.translation_m
    azimuth = math.atan2(place[1], place[0])
    rest = (SO3.axis("z", -azimuth) @ T_world_base.rotation).matrix
    return {
        "azimuth_rad": azimuth,
        "sideways_m": math.hypot(place[0], place[1]),
        "up_m": float(place[2]),
        "tilt_rad": math.atan2(rest[0, 2], rest[2, 2]),
        "spin_rad": math.atan2(rest[1, 0], rest[1, 1]),
    }


def written(setup: SutureSetup, preset: SutureSetup) -> list[str]:
    """Return the options that make this setup from a preset's, so far as circle, base, needle and grasp differ."""
    was, now = _numbers(preset), _numbers(setup)
    texts = [f"{name} {value:.9g}" for name, value in now.items() if abs(value - was[name]) > 1e-9]
    was_at, at = (1e3 * one.circle.T_world_circle.translation_m for one in (preset, setup))
    if np.abs(at - was_at).max() > 1e-9:
        texts.append("--center-mm " + " ".join(f"{value:.9g}" for value in at))
    return texts


def _numbers(setup: SutureSetup) -> dict[str, float]:
    """Return options with their values in mm and deg."""
    base = base_numbers(setup.T_world_base)
    found = {
        "--circle-radius-mm": 1e3 * setup.circle.radius_m,
        "--base-azimuth-deg": math.degrees(base["azimuth_rad"]),
        "--base-sideways-mm": 1e3 * base["sideways_m"],
        "--base-up-mm": 1e3 * base["up_m"],
        "--base-tilt-deg": math.degrees(base["tilt_rad"]),
        "--base-spin-deg": math.degrees(base["spin_rad"]),
        "--needle-radius-mm": 1e3 * setup.needle.radius_m,
        "--grasp-behind-tip-deg": math.degrees(setup.grasp.behind_tip_rad),
    }
    for name in ("approach", "lean", "skew"):
        found[f"--grasp-{name}-deg"] = math.degrees(getattr(setup.grasp, f"{name}_rad"))
    return found


def spacing_of(
    count: int,
    positions: int,
    least_deg: float | None,
    most_deg: float | None,
    forbid: Sequence[str],
    fix_deg: Sequence[float],
    tension: float,
) -> Spacing | None:
    """Return what is asked of the places; None for the paper's even spacing.

    A bound that is not given is free (one step of the grid, a whole turn) if the other is, or if tension is weighed;
    else every gap is even.
    """
    if least_deg is None and most_deg is None and not (forbid or fix_deg or tension):
        return None
    arcs = tuple(_arc(text) for text in forbid)
    even = 2 * math.pi / max(count, 1)
    free = least_deg is not None or most_deg is not None or tension > 0
    least = math.radians(least_deg) if least_deg is not None else 2 * math.pi / positions if free else even
    most = math.radians(most_deg) if most_deg is not None else 2 * math.pi if free else even
    return Spacing(least, most, arcs, tuple(math.radians(angle) for angle in fix_deg), tension)


def rad(value_deg: float | None) -> float | None:
    """Return degrees as rad; None stays None."""
    return None if value_deg is None else math.radians(value_deg)


def metre(value_mm: float | None) -> float | None:
    """Return mm as m; None stays None."""
    return None if value_mm is None else value_mm / 1e3


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was given on the command line; None is not given."""
    return {name: value for name, value in values.items() if value is not None}


def _circle(
    circle: Circle, center_mm: Sequence[float] | None, normal: Sequence[float] | None, changes: Mapping[str, Any]
) -> Circle:
    """Return the circle moved to a centre and turned to a normal."""
    T_world_circle = circle.T_world_circle
    attitude, center = T_world_circle.rotation, T_world_circle.translation_m
    if center_mm is not None:
        if not (np.isfinite(center_mm).all() and np.abs(center_mm).max() <= 500):
            raise TrocarError(f"the circle's centre is {tuple(center_mm)} mm; give three numbers of -500 to 500 mm")
        center = np.asarray(center_mm) / 1e3
    if normal is not None:
        attitude = _turned_to(normal)
    return replace(circle, T_world_circle=SE3.from_parts(attitude, center), **changes)


def _turned_to(normal: Sequence[float]) -> SO3:
    """Return the smallest rotation that takes z to this direction."""
    length = float(np.linalg.norm(normal))
    if not (math.isfinite(length) and length > 1e-9):
        raise TrocarError(f"the tissue's normal is {tuple(normal)}; give a direction such as 0 0 1")
    x, y, z = np.asarray(normal) / length
    axis = np.array([-y, x, 0.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return SO3.axis("x", 0.0 if z > 0 else math.pi)
    return SO3.exp(axis / sine * math.atan2(sine, z))


def _arc(text: str) -> tuple[float, float]:
    """Return a forbidden arc in rad from ``FROM:TO`` in degrees."""
    try:
        start, end = (math.radians(float(part)) for part in text.split(":"))
    except ValueError:
        raise TrocarError(f"the forbidden arc is '{text}'; give two angles in deg as FROM:TO, such as 10:40") from None
    return start, end
