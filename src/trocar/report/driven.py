"""Driven sutures in numbers: joints against what they were asked for, needle against its plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.sutures import PRESETS, SutureSetup
from trocar.sutures.drive import Suture
from trocar.sutures.plan_file import setup_from
from trocar.trials.trial import Trial

MODELLED = (
    "no tissue mechanics: the phantom bears the needle and drags on it (viscous), and is solid to nothing",
    "the jaws hold the needle by friction; a person pulls it out and loads it again, exactly, before each suture",
)
"""What a reader of the figures must know; printed with them."""


def setup_of(trial: Trial) -> SutureSetup:
    """Return the geometry that a trial's sutures were planned for."""
    planned: Any = trial.about.get("planned")
    return setup_from(planned["setup"]) if planned else PRESETS[str(trial.about["preset"])].setup


def arm_of(trial: Trial) -> str:
    """Return the name of the arm that drove."""
    return str(trial.about["settings"]["arm"])  # type: ignore[index]


def suture_of(trial: Trial, score: Mapping[str, Any]) -> Suture:
    """Return what was planned for a scored suture."""
    return Suture(setup_of(trial), float(np.radians(score["theta_deg"])), int(score["direction"]))


def steps_of(trial: Trial, number: int) -> list[tuple[str, float, float]]:
    """Return (name, start, end in s) of the steps that a suture came to."""
    steps = [event for event in trial.events if event["name"] == "step" and event["suture"] == number]
    begins = [float(event["time_s"]) for event in steps]  # type: ignore[arg-type]
    ends = [*begins, float(trial.transfers[number]["end_s"])][1:]  # type: ignore[arg-type]
    return [(str(event["step"]), a, b) for event, a, b in zip(steps, begins, ends, strict=True)]


def primitive_times(trial: Trial, number: int) -> tuple[float, float] | None:
    """Return from when to when a suture's primitive ran; None if it never began."""
    inside = [(a, b) for name, a, b in steps_of(trial, number) if name.startswith(("pen", "rot", "regrasp", "push"))]
    return (inside[0][0], inside[-1][1]) if inside else None


def asked_at(trial: Trial, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joints (n, 6) that the script asked for at these times; between motions, its last ones."""
    arm = arm_of(trial)
    at, q = trial.arrays[f"asked_s_{arm}"], trial.arrays[f"asked_{arm}"]
    return np.column_stack([np.interp(times_s, at, column) for column in q.T])


def joint_errors(trial: Trial) -> NDArray[np.float64]:
    """Return true less asked joints (n, 6) at 100 Hz while primitives ran, rad and m."""
    times, q = trial.arrays["truth_s"], trial.arrays[f"joints_{arm_of(trial)}"]
    rows = np.zeros(len(times), dtype=bool)
    for number in range(len(trial.transfers)):
        between = primitive_times(trial, number)
        if between is not None:
            rows |= (times >= between[0]) & (times <= between[1])
    return q[rows] - asked_at(trial, times[rows])


def driven_summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the keys that a run of sutures adds to its summary; None where nothing was driven so far."""
    setup = setup_of(trials[0])
    errors = np.concatenate([joint_errors(trial) for trial in trials])
    scores = [score for trial in trials for score in trial.transfers]
    stops = [str(s["reason"]) for s in scores if s["failure"] == "JOINT_LIMIT"]
    most = max((trial.transfers for trial in trials), key=len)
    planned = int(trials[0].about["sutures"]) * len(trials)  # type: ignore[call-overload]
    return {
        "preset": trials[0].about.get("preset"),
        "sutures": [{"theta_deg": s["theta_deg"], "direction": s["direction"]} for s in most],
        "not_attempted": planned - len(scores),
        "joint_error_deg": {
            joint.name: _rms_max(np.degrees(errors[:, index]))
            for index, joint in enumerate(setup.arm.joints)
            if not joint.prismatic
        },
        "insertion_error_mm": _rms_max(1e3 * errors[:, 2]),
        "tip_error_mm": {
            "rms": _of(scores, "tip_rms_m", lambda v: float(np.sqrt(np.mean(v**2)))),
            "max": _of(scores, "tip_max_m", np.max),
        },
        "entry_error_mm": {"mean": _of(scores, "entry_error_m", np.mean), "max": _of(scores, "entry_error_m", np.max)},
        "exit_error_mm": {"mean": _of(scores, "exit_error_m", np.mean), "max": _of(scores, "exit_error_m", np.max)},
        "slip_mm": {"max": _of(scores, "slip_m", np.max)},
        "stopped": stops,
        "modelled": list(MODELLED),
    }


def limits_shown(arm: ArmModel, index: int) -> tuple[float, float, float, str]:
    """Return lower and upper limit as shown, the scale from rad or m, and the unit."""
    joint = arm.joints[index]
    scale, unit = (1e3, "mm") if joint.prismatic else (180 / np.pi, "deg")
    return scale * joint.lower, scale * joint.upper, scale, unit


def _rms_max(errors: NDArray[np.float64]) -> dict[str, float | None]:
    if not len(errors):
        return {"rms": None, "max": None}
    return {"rms": float(np.sqrt(np.mean(errors**2))), "max": float(np.abs(errors).max())}


def _of(scores: Sequence[Mapping[str, Any]], key: str, of: Any) -> float | None:
    """Return a figure of what was measured, in mm; None if nothing was."""
    values = np.array([score[key] for score in scores if score[key] is not None], dtype=np.float64)
    return float(1e3 * of(values)) if len(values) else None
