"""Options of the suture commands, in degrees and mm, and the setup, reward and spacing that they define."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN, direction
from trocar.tasks.suture.planning import MARGINS, PRESETS, Circle, Preset, Reward, SutureSetup, base_beside
from trocar.tasks.suture.planning.plan import Spacing
from trocar.tasks.suture.planning.rewards import JOINTS, SCALINGS

if TYPE_CHECKING:
    from trocar.tasks.suture.demonstrations import Demonstrations

T = TypeVar("T")

REWARD, SPACING, GIVEN = "Reward", "Positions of the sutures", "Arm, circle, needle (default: the preset's)"


def option(group: str, help: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Return a documented option of a group."""
    return typer.Option(*([name] if name else []), help=help, metavar=metavar, rich_help_panel=group)


PresetName = Annotated[str, typer.Option("--preset", help=f"Initial setup and reward: {', '.join(PRESETS)}.")]
DemonstrationsPath = Annotated[
    str | None,
    option(
        REWARD,
        "Recorded sutures for the manipulability (a manifest or its folder), or `synthetic`.",
        "PATH",
        "--demonstrations",
    ),
]
Margin = Annotated[str | None, option(REWARD, f"Formula of the joint margin: {', '.join(MARGINS)}.")]
Weight = Annotated[float | None, option(REWARD, "lambda, the weight of the margin; manipulability gets the rest.")]
Scaling = Annotated[str | None, option(REWARD, f"How margin and manipulability are scaled: {', '.join(SCALINGS)}.")]
Joints = Annotated[str | None, option(REWARD, f"Joints that the margin considers: {', '.join(JOINTS)}.")]
At = Annotated[str | None, option(REWARD, "Where it is evaluated: stations (start and end of movements) or path.")]
FeasibleFirst = Annotated[
    bool | None,
    typer.Option(
        "--feasible-first/--reward-first",
        help="Choose an infeasible direction only where both are, or choose by reward alone.",
        rich_help_panel=REWARD,
    ),
]
ArmName = Annotated[str | None, option(GIVEN, f"Arm that sutures: {', '.join(ARMS)}.", name="--arm")]
CircleRadius = Annotated[float | None, option(GIVEN, "Radius of the circle of sutures.", "MM")]
Center = Annotated[
    tuple[float, float, float] | None, option(GIVEN, "Centre of the circle in the world.", "X Y Z", "--center-mm")
]
Normal = Annotated[
    tuple[float, float, float] | None,
    option(GIVEN, "Normal of the tissue, outwards; theta then starts near the world's x.", "X Y Z"),
]
BaseAzimuth = Annotated[float | None, option(GIVEN, "Direction of the arm's base, counterclockwise from x.", "DEG")]
BaseSideways = Annotated[float | None, option(GIVEN, "Horizontal distance of the base from the world's origin.", "MM")]
BaseUp = Annotated[float | None, option(GIVEN, "Height of the base.", "MM")]
BaseTilt = Annotated[float | None, option(GIVEN, "Lean of the resting instrument towards the origin.", "DEG")]
BaseSpin = Annotated[float | None, option(GIVEN, "Rotation of the base about its z.", "DEG")]
NeedleRadius = Annotated[float | None, option(GIVEN, "Radius of the needle's curvature.", "MM")]
NeedleArc = Annotated[float | None, option(GIVEN, "Arc of the needle from tip to tail.", "DEG")]
BehindTip = Annotated[
    float | None, option(GIVEN, "Arc from the needle's tip back to the jaws.", "DEG", "--grasp-behind-tip-deg")
]
Approach = Annotated[float | None, option(GIVEN, "Rotation of the jaws about the wire.", "DEG", "--grasp-approach-deg")]
Lean = Annotated[
    float | None, option(GIVEN, "Rotation of the jaws about their closing direction.", "DEG", "--grasp-lean-deg")
]
Skew = Annotated[float | None, option(GIVEN, "Rotation of the jaws about their long axis.", "DEG", "--grasp-skew-deg")]
EntryAngle = Annotated[float | None, option(GIVEN, "Angle between the entering needle and the surface.", "DEG")]
Straight = Annotated[float | None, option(GIVEN, "Length of the straight penetration.", "MM", "--straight-mm")]
Rotation = Annotated[
    float | None, option(GIVEN, "Rotation about the needle's centre that follows.", "DEG", "--rotation-deg")
]
Regrasp = Annotated[float | None, option(GIVEN, "How far the jaws move back along the needle.", "DEG", "--regrasp-deg")]
Pushes = Annotated[int | None, option(GIVEN, "How often they do so and push the needle on.")]
ThetaIs = Annotated[str | None, option(GIVEN, "Which point of a suture lies at theta: entry or middle.")]


def chosen(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise TrocarError with the available names."""
    if name not in table:
        raise TrocarError(f"no {what} is called '{name}'; choose one of: {', '.join(table)}")
    return table[name]


def recorded(demonstrations: str | None) -> Demonstrations | None:
    """Return the demonstrations at this path, or the synthetic ones; None if no path is given."""
    if demonstrations is None:
        return None
    from trocar.tasks.suture.demonstrations import load_demonstrations, synthetic_demonstrations

    return synthetic_demonstrations() if demonstrations == "synthetic" else load_demonstrations(demonstrations)


def changed_reward(preset: Preset, **fields: Any) -> Reward:
    """Return the preset's reward with the fields given on the command line; None means not given."""
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
    """Return the preset's setup with the values given on the command line; None means not given.

    Args:
        preset: gives all other values.
        arm: name of another arm.
        center_mm: centre of the circle.
        normal: normal of the tissue.
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
    """Return the arguments of ``base_beside`` that give this base."""
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
    """Return the options that turn a preset's setup into this one, for circle, base, needle and grasp."""
    was, now = _numbers(preset), _numbers(setup)
    texts = [f"{name} {value:.9g}" for name, value in now.items() if abs(value - was[name]) > 1e-9]
    was_at, at = (1e3 * one.circle.T_world_circle.translation_m for one in (preset, setup))
    if np.abs(at - was_at).max() > 1e-9:
        texts.append("--center-mm " + " ".join(f"{value:.9g}" for value in at))
    return texts


def _numbers(setup: SutureSetup) -> dict[str, float]:
    """Return these options of a setup with their values in mm and deg."""
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
    min_gap_deg: float | None,
    max_gap_deg: float | None,
    forbid_deg: Sequence[str],
    fix_deg: Sequence[float],
    tension: float,
) -> Spacing | None:
    """Return the constraints on the positions; None for the paper's even spacing.

    A bound that is not given is free (one step of the grid, a whole turn) if the other is given or tension has a
    weight; otherwise all gaps are equal.
    """
    if min_gap_deg is None and max_gap_deg is None and not (forbid_deg or fix_deg or tension):
        return None
    arcs = tuple(_arc(text) for text in forbid_deg)
    even = TURN / max(count, 1)
    free = min_gap_deg is not None or max_gap_deg is not None or tension > 0
    min_gap = math.radians(min_gap_deg) if min_gap_deg is not None else TURN / positions if free else even
    max_gap = math.radians(max_gap_deg) if max_gap_deg is not None else TURN if free else even
    return Spacing(min_gap, max_gap, arcs, tuple(math.radians(angle) for angle in fix_deg), tension)


def rad(value_deg: float | None) -> float | None:
    """Return degrees as rad; None stays None."""
    return None if value_deg is None else math.radians(value_deg)


def metre(value_mm: float | None) -> float | None:
    """Return mm as m; None stays None."""
    return None if value_mm is None else value_mm / 1e3


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that were given on the command line; None means not given."""
    return {name: value for name, value in values.items() if value is not None}


def _circle(
    circle: Circle, center_mm: Sequence[float] | None, normal: Sequence[float] | None, changes: Mapping[str, Any]
) -> Circle:
    """Return the circle with this centre and normal."""
    T_world_circle = circle.T_world_circle
    attitude, center = T_world_circle.rotation, T_world_circle.translation_m
    if center_mm is not None:
        if not (np.isfinite(center_mm).all() and np.abs(center_mm).max() <= 500):
            raise TrocarError(f"the circle's centre is {tuple(center_mm)} mm; give three numbers from -500 to 500 mm")
        center = np.asarray(center_mm) / 1e3
    if normal is not None:
        attitude = _turned_to(normal)
    return replace(circle, T_world_circle=SE3.from_parts(attitude, center), **changes)


def _turned_to(normal: Sequence[float]) -> SO3:
    """Return the smallest rotation that takes z to this direction."""
    return SO3.between([0.0, 0.0, 1.0], direction(normal, "the tissue's normal"))


def _arc(text: str) -> tuple[float, float]:
    """Return a forbidden arc in rad from ``FROM:TO`` in degrees."""
    try:
        start, end = (math.radians(float(part)) for part in text.split(":"))
    except ValueError:
        raise TrocarError(f"the forbidden arc is '{text}'; give two angles in deg as FROM:TO, such as 10:40") from None
    return start, end
