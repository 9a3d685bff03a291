"""Calls of public constructors and functions: good arguments, of which one or two are not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fuzzing.files import LIFTED, OVER
from fuzzing.values import ARRAYS, LITERALS
from trocar.arms import ARMS, MOTION_LIMITS, PSM_CLASSIC, fk, ik, ik_branches, jacobian
from trocar.calibration.compensation import Compensator
from trocar.calibration.models import MODELS, OffsetModel
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from trocar.geometry import SE3, SO3, fit_rigid
from trocar.lab import built_in_stations, load_station
from trocar.motion import ArmMotion, MotionProblem, move_to, open_box, plan_motion, rest_to_rest, wall
from trocar.motion.analysis import analyse
from trocar.tasks.suture.planning import (
    PRESETS,
    Spacing,
    SutureJoints,
    base_beside,
    dexterity,
    plan_even,
    plan_gaps,
    suture_joints,
)
from trocar.trajectory import Trajectory

ENDS = np.array([LIFTED[0], OVER[0]])
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (8, 3))


def _recording() -> Recording:
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.03, (60, 6)), axis=0), -1, 1)
    return Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(60, bool), np.arange(60.0))


RECORDING = _recording()
MODEL = MODELS["offset"].fit(RECORDING, np.random.default_rng(0))
MOTION = ArmMotion(PSM_CLASSIC, ENDS, MOTION_LIMITS["paper"])
PROBLEM = MotionProblem({"psm": MOTION})
PRESET = PRESETS["default"]
MAP = dexterity(PRESET.setup, PRESET.reward, 40)

FUNCTIONS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "SE3.exp": (SE3.exp, {"twist": np.zeros(6)}),
    "SE3.from_parts": (SE3.from_parts, {"rotation": SO3.identity(), "translation_m": (0.0, 0.0, 0.1)}),
    "SO3.exp": (SO3.exp, {"rotvec_rad": np.zeros(3)}),
    "SO3.axis": (SO3.axis, {"axis": "z", "angle_rad": 0.3}),
    "SO3.from_quaternion": (SO3.from_quaternion, {"wxyz": [1.0, 0.0, 0.0, 0.0]}),
    "fit_rigid": (fit_rigid, {"source_m": POINTS, "target_m": POINTS + 0.1, "weights": np.ones(8)}),
    "fk": (fk, {"arm": PSM_CLASSIC, "q": ENDS}),
    "jacobian": (jacobian, {"arm": PSM_CLASSIC, "q": ENDS}),
    "ik": (ik, {"arm": PSM_CLASSIC, "T_base_tip": fk(PSM_CLASSIC, ENDS[0]), "reference": ENDS[0]}),
    "ik_branches": (ik_branches, {"arm": PSM_CLASSIC, "T_base_tip": fk(PSM_CLASSIC, ENDS[0])}),
    "Trajectory.hermite": (Trajectory.hermite, {"times_s": [0.0, 1.0], "q": ENDS, "v": np.zeros((2, 6))}),
    "Trajectory.sample": (rest_to_rest(*ENDS, MOTION_LIMITS["paper"]).sample, {"step_s": 0.01}),
    "Trajectory.stretched": (rest_to_rest(*ENDS, MOTION_LIMITS["paper"]).stretched, {"factor": 2.0}),
    "plan_motion": (plan_motion, {"problem": PROBLEM, "planner": "spline"}),
    "move_to": (move_to, {"q": ENDS[0], "velocity": np.zeros(6), "q_goal": ENDS[1], "limits": MOTION_LIMITS["paper"]}),
    "analyse": (analyse, {"measured": np.sin(np.linspace(0, 1, 40))[:, None], "step_s": 0.01, "smoothness": 1.0}),
    "OffsetModel.fit": (OffsetModel.fit, {"recording": RECORDING, "rng": np.random.default_rng(0)}),
    "model.predict": (MODEL.predict, {"q_cmd": ENDS}),
    "Compensator.path": (Compensator(MODEL).path, {"q_desired": ENDS}),
    "base_beside": (base_beside, {"azimuth_rad": 0.1, "sideways_m": 0.1, "up_m": 0.1, "tilt_rad": 0.0}),
    "suture_joints": (suture_joints, {"setup": PRESET.setup, "thetas_rad": np.array([0.0, 1.0])}),
    "dexterity": (dexterity, {"setup": PRESET.setup, "reward": PRESET.reward, "positions": 8, "source": ""}),
    "plan_even": (plan_even, {"map": MAP, "count": 4}),
    "plan_gaps": (plan_gaps, {"map": MAP, "count": 4, "spacing": Spacing.even(4)}),
    "wall": (
        wall,
        {"name": "w", "start_m": [0.0, 0.0, 0.0], "end_m": [0.1, 0.0, 0.0], "height_m": 0.1, "radius_m": 0.01},
    ),
    "open_box": (
        open_box,
        {"name": "b", "T_world_box": SE3.identity(), "inside_m": (0.1, 0.1), "height_m": 0.1, "radius_m": 0.01},
    ),
}
"""Functions with good arguments."""


def _harvested(*roots: Any) -> dict[str, Any]:
    """Return one good value of every public dataclass that can be reached from some values, by name."""
    found: dict[str, Any] = {}
    waiting, seen = list(roots), set()
    while waiting:
        value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if is_dataclass(value) and not isinstance(value, type):
            kind = type(value)
            if kind.__module__.startswith("trocar") and not kind.__name__.startswith("_"):
                found.setdefault(kind.__name__, value)
            waiting += [getattr(value, f.name) for f in fields(value)]
        elif isinstance(value, Mapping):
            waiting += list(value.values())
        elif isinstance(value, list | tuple):
            waiting += list(value)
    return found


VALUES = _harvested(
    *(load_station(name) for name in built_in_stations()),
    *(PRESETS.values(), ARMS.values(), MOTION_LIMITS.values()),
    *(list(PRESETS.values()), list(ARMS.values()), RECORDING, MODEL, PROBLEM, MAP, plan_even(MAP, 4)),
    *(plan_motion(PROBLEM), PSM1_GREY, SutureJoints, SE3.identity(), SO3.identity(), Spacing.even(4)),
)
RESULTS = {"DexterityMap", "LimitUse", "MotionPlan", "OffsetModel", "SutureJoints", "SuturePlan", "TimedPath"}
"""What fits and planners return; nobody makes one by hand."""
CONSTRUCTORS = sorted([*FUNCTIONS, *(VALUES.keys() - RESULTS)])
PLAIN = (bool, int, float, str, np.ndarray, list, tuple)
"""Types of arguments that are replaced. What stands in the place of an object is found out where it is used."""


@dataclass(frozen=True)
class Call:
    """A call with some arguments replaced.

    Attributes:
        name: of what is called.
        replaced: arguments that are not good.
    """

    name: str
    replaced: tuple[tuple[str, Any], ...]

    def __call__(self) -> Any:
        """Return what it returns."""
        if self.name in FUNCTIONS:
            function, given = FUNCTIONS[self.name]
            return function(**{**given, **dict(self.replaced)})
        value = VALUES[self.name]
        given = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        return type(value)(**{**given, **dict(self.replaced)})

    def __str__(self) -> str:
        return f"{self.name}({', '.join(f'{name}={value!r}' for name, value in self.replaced)})"


@st.composite
def calls(draw: st.DrawFn) -> Call:
    """Return a call of which one or two arguments are of the right type with odd values, or of another type."""
    name = draw(st.sampled_from(CONSTRUCTORS))
    value = VALUES.get(name)
    given = FUNCTIONS[name][1] if value is None else {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    given = {key: one for key, one in given.items() if isinstance(one, PLAIN)}
    if not given:
        return Call(name, ())
    chosen = draw(st.lists(st.sampled_from(sorted(given)), min_size=1, max_size=2, unique=True))
    return Call(name, tuple((one, draw(_odd(given[one]))) for one in chosen))


def _odd(good: Any) -> st.SearchStrategy[Any]:  # noqa: PLR0911 (a line for each type)
    """Return values in the place of a good one: mostly of its type."""
    if isinstance(good, bool):
        return st.sampled_from([True, False, None, "yes"])
    if isinstance(good, int):
        return st.sampled_from([0, -1, 1, 2, 7, 10**30, 2**63, True, 0.5, float("nan"), None])
    if isinstance(good, float):
        numbers = [value for value in LITERALS if isinstance(value, int | float)]
        return st.sampled_from([*numbers, *numbers, 1e-320, None, "x"])
    if isinstance(good, str):
        return st.sampled_from(["", "x", "x" * 300, "ä", "\0", None, 1])
    if isinstance(good, np.ndarray):
        return st.sampled_from(ARRAYS) | st.builds(_spoiled, st.just(good), st.sampled_from([np.nan, np.inf, 1e308, 0]))
    if isinstance(good, tuple) and good:
        shorter = st.sampled_from([(), good[:-1], (*good, good[-1]), None])
        return shorter | st.builds(lambda odd: (odd, *good[1:]), st.deferred(lambda: _odd(good[0])))
    return st.sampled_from([None, "x", 1.0, (), []]) if isinstance(good, PLAIN) else st.just(good)


def _spoiled(good: np.ndarray, value: float) -> np.ndarray:
    """Return an array with its first number replaced."""
    spoiled = np.array(good)
    if spoiled.size and spoiled.dtype.kind == "f":
        spoiled.flat[0] = value
    return spoiled
