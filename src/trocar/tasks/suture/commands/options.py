"""Options that the suture commands share: arm, circle, needle, grasp, reward and spacing, in degrees and mm."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer

from trocar.arms import ARMS
from trocar.errors import InvalidValue, UnknownName
from trocar.geometry import SE3, SO3, TURN, direction
from trocar.geometry.arrays import finite
from trocar.tasks.suture.demonstrations import Demonstrations, load_demonstrations, synthetic_demonstrations
from trocar.tasks.suture.planning import MARGINS, PRESETS, Preset, Reward, Spacing, SutureSetup, plan_even, plan_gaps
from trocar.tasks.suture.planning.parameters import PARAMETERS, parameters_of, shown_parameter, with_parameters
from trocar.tasks.suture.planning.plan import Planner
from trocar.tasks.suture.planning.rewards import JOINTS, SCALINGS

T = TypeVar("T")

REWARD, SPACING, GIVEN = "Reward", "Positions of the sutures", "Arm, circle, needle (default: the preset's)"
MAX_CENTER_MM = 500.0


def option(group: str, help: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Return a documented option of a group."""
    return typer.Option(*([name] if name else []), help=help, metavar=metavar, rich_help_panel=group)


PresetName = Annotated[str, typer.Option("--preset", help=f"Initial setup and reward: {', '.join(PRESETS)}.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Save results and pictures here.")]
ArmName = Annotated[str | None, option(GIVEN, f"Arm that sutures: {', '.join(ARMS)}.", name="--arm")]
MinGap = Annotated[float | None, option(SPACING, "Smallest gap of neighbours; default: even.", "DEG", "--min-gap-deg")]
MaxGap = Annotated[float | None, option(SPACING, "Largest gap of neighbours; default: even.", "DEG", "--max-gap-deg")]
DemonstrationsPath = Annotated[
    str | None,
    option(REWARD, "Recorded sutures for the manipulability (a manifest or its folder), or `synthetic`.", "PATH"),
]
Triple = tuple[float, float, float]

OF_REWARD: dict[str, Any] = {
    "margin": Annotated[str | None, option(REWARD, f"Formula of the joint margin: {', '.join(MARGINS)}.")],
    "weight": Annotated[
        float | None, option(REWARD, "lambda, the weight of the margin; manipulability gets the rest.")
    ],
    "scaling": Annotated[
        str | None, option(REWARD, f"How margin and manipulability are scaled: {', '.join(SCALINGS)}.")
    ],
    "joints": Annotated[str | None, option(REWARD, f"Joints that the margin considers: {', '.join(JOINTS)}.")],
    "at": Annotated[
        str | None, option(REWARD, "Where it is evaluated: stations (start and end of movements) or path.")
    ],
    "feasible_first": Annotated[
        bool | None,
        option(
            REWARD,
            "Choose an infeasible direction only where both are, or choose by reward alone.",
            name="--feasible-first/--reward-first",
        ),
    ],
}
"""Fields of ``Reward``."""

OF_INSERTION: dict[str, Any] = {
    "pushes": Annotated[int | None, option(GIVEN, "How often the jaws go back along the needle and push it on.")],
    "theta_is": Annotated[str | None, option(GIVEN, "Which point of a suture lies at theta: entry or middle.")],
}
"""Fields of ``Insertion`` that are no lengths or angles."""

OF_CIRCLE: dict[str, Any] = {
    "center_mm": Annotated[Triple | None, option(GIVEN, "Centre of the circle in the world.", "X Y Z", "--center-mm")],
    "normal": Annotated[
        Triple | None, option(GIVEN, "Normal of the tissue, outwards; theta then starts near the world's x.", "X Y Z")
    ],
}
"""The circle's pose."""

OF_SETUP = {
    shown_parameter(name)[1]: Annotated[
        float | None,
        option(
            GIVEN,
            parameter.about,
            "MM" if name.endswith("_m") else "DEG",
            "--" + shown_parameter(name)[1].replace("_", "-"),
        ),
    ]
    for name, parameter in PARAMETERS.items()
    if parameter.part != "center"
}
"""Parameters of a setup."""


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of a reward and a setup; its function gets those that were given, by name."""
    added = {**OF_REWARD, **OF_CIRCLE, **OF_SETUP, **OF_INSERTION}
    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "given"]
    keyword = inspect.Parameter.KEYWORD_ONLY
    both = [*own, *(inspect.Parameter(name, keyword, default=None, annotation=kind) for name, kind in added.items())]

    def command(**values: Any) -> None:
        given = {name: value for name in added if (value := values.pop(name)) is not None}
        function(given=given, **values)

    command.__doc__ = function.__doc__
    command.__signature__ = inspect.Signature(both)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in both}
    return command


def pick(table: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of this name, or raise UnknownName."""
    if name not in table:
        raise UnknownName(f"the {what}", name, table)
    return table[name]


def recorded(demonstrations: str | None) -> Demonstrations | None:
    """Return the demonstrations at this path, or the synthetic ones; None if no path is given."""
    if demonstrations is None:
        return None
    return synthetic_demonstrations() if demonstrations == "synthetic" else load_demonstrations(demonstrations)


def reward_of(preset: Preset, given: Mapping[str, Any]) -> Reward:
    """Return the preset's reward with the options that were given."""
    return replace(preset.reward, **_those(given, OF_REWARD))


def setup_of(preset: Preset, arm: str | None, given: Mapping[str, Any]) -> SutureSetup:
    """Return the preset's setup with another arm, and with the options that were given."""
    setup, circle = preset.setup, preset.setup.circle
    flags = {name: shown_parameter(name)[1] for name in PARAMETERS}
    return with_parameters(
        setup,
        {name: in_si(name, given[flag]) for name, flag in flags.items() if flag in given},
        arm=setup.arm if arm is None else pick(ARMS, arm, "arm"),
        circle=replace(circle, T_world_circle=_circle_pose(circle.T_world_circle, **_those(given, OF_CIRCLE))),
        insertion=replace(setup.insertion, **_those(given, OF_INSERTION)),
    )


def in_si(name: str, value: float) -> float:
    """Return the value of a parameter in m or rad, given in mm or deg."""
    return math.radians(value) if name.endswith("_rad") else value / 1e3


def _those(given: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if name in options}


def _circle_pose(T: SE3, center_mm: Triple | None = None, normal: Triple | None = None) -> SE3:
    """Return the circle's pose with this centre and normal, by the smallest rotation from the world's z."""
    center_m, attitude = T.translation_m, T.rotation
    if center_mm is not None:
        center_m = finite("the circle's centre in mm", center_mm, 3) / 1e3
        if np.abs(center_mm).max() > MAX_CENTER_MM:
            raise InvalidValue("the circle's centre", f"{center_mm} mm", "give three numbers from -500 to 500 mm")
    if normal is not None:
        attitude = SO3.between([0.0, 0.0, 1.0], direction(normal, "the tissue's normal"))
    return SE3.from_parts(attitude, center_m)


def written(setup: SutureSetup, preset: SutureSetup) -> list[str]:
    """Return the options that turn a preset's setup into this one, apart from arm, normal and insertion."""
    was, now = parameters_of(preset), parameters_of(setup)
    texts = []
    for name, value in now.items():
        scale, said = shown_parameter(name)
        if scale * abs(value - was[name]) > 1e-9:
            texts.append(f"--{said.replace('_', '-')} {scale * value:.9g}")
    was_mm, now_mm = (1e3 * one.circle.T_world_circle.translation_m for one in (preset, setup))
    if np.abs(now_mm - was_mm).max() > 1e-9:
        texts.append("--center-mm " + " ".join(f"{value:.9g}" for value in now_mm))
    return texts


def spacing_of(
    count: int,
    positions: int,
    min_gap_deg: float | None,
    max_gap_deg: float | None,
    forbid_deg: Sequence[str] = (),
    fix_deg: Sequence[float] = (),
    tension: float = 0.0,
) -> Spacing | None:
    """Return the constraints on the positions; None for the paper's even spacing.

    A bound that is not given is free (one step of the grid, a whole turn) if the other is given or tension has a
    weight; otherwise all gaps are equal.
    """
    if min_gap_deg is None and max_gap_deg is None and not (forbid_deg or fix_deg or tension):
        return None
    even = TURN / max(count, 1)
    free = min_gap_deg is not None or max_gap_deg is not None or tension > 0
    min_gap = math.radians(min_gap_deg) if min_gap_deg is not None else TURN / positions if free else even
    max_gap = math.radians(max_gap_deg) if max_gap_deg is not None else TURN if free else even
    fixed = tuple(math.radians(angle) for angle in fix_deg)
    return Spacing(min_gap, max_gap, tuple(_arc(text) for text in forbid_deg), fixed, tension)


def planner_of(count: int, spacing: Spacing | None) -> Planner:
    """Return the planner on the grid: of evenly spaced sutures, or of those with this spacing."""
    return partial(plan_even, count=count) if spacing is None else partial(plan_gaps, count=count, spacing=spacing)


def _arc(text: str) -> tuple[float, float]:
    """Return a forbidden arc in rad from ``FROM:TO`` in degrees."""
    try:
        start, end = (math.radians(float(part)) for part in text.split(":"))
    except ValueError:
        raise InvalidValue(
            "the forbidden arc", repr(text), "give two angles in deg as FROM:TO, such as 10:40"
        ) from None
    return start, end


def files_line(summary: Mapping[str, Any]) -> list[str]:
    """Return a line that names the files that were written, if any were."""
    return ["files: " + ", ".join(summary["files"])] if "files" in summary else []
