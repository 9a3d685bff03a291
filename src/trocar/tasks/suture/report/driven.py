"""Driven sutures in numbers: true against asked joints, needle against its plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.eval.trial import Trial
from trocar.tasks.suture.planning import PRESETS, SutureSetup
from trocar.tasks.suture.planning.drive import Suture
from trocar.tasks.suture.planning.plan_file import setup_from


def setup_of(trial: Trial) -> SutureSetup:
    """Return the geometry that a trial's sutures were planned for."""
    options = trial.about["options"]
    planned = options["plan_file"]
    return setup_from(planned["setup"]) if planned else PRESETS[str(options["preset"])].setup


def arm_of(trial: Trial) -> str:
    """Return the name of the arm that drove."""
    return str(trial.about["arms"][0])


def suture_of(trial: Trial, score: Mapping[str, Any]) -> Suture:
    """Return what was planned for a scored suture."""
    return Suture(setup_of(trial), float(np.radians(score["theta_deg"])), int(score["direction"]))


def steps_of(trial: Trial, number: int) -> list[tuple[str, float, float]]:
    """Return (name, start, end in s) of the steps of a suture that the script noted."""
    steps = [event for event in trial.events if event["name"] == "step" and event["suture"] == number]
    begins = [float(event["time_s"]) for event in steps]
    ends = [*begins, float(trial.scores[number]["end_s"])][1:]
    return [(str(event["step"]), a, b) for event, a, b in zip(steps, begins, ends, strict=True)]


def primitive_times(trial: Trial, number: int) -> tuple[float, float] | None:
    """Return the start and end time of a suture's primitive; None if it never began."""
    inside = [(a, b) for name, a, b in steps_of(trial, number) if name.startswith(("pen", "rot", "regrasp", "push"))]
    return (inside[0][0], inside[-1][1]) if inside else None


def joint_errors(trial: Trial) -> NDArray[np.float64]:
    """Return true minus asked joints (n, 6) at 100 Hz while primitives ran, rad and m."""
    arm, times = arm_of(trial), trial.times_s
    rows = np.zeros(len(times), dtype=bool)
    for number in range(len(trial.scores)):
        between = primitive_times(trial, number)
        if between is not None:
            rows |= (times >= between[0]) & (times <= between[1])
    errors = trial.arrays[f"true_{arm}"] - trial.arrays[f"asked_{arm}"]
    return errors[rows, :6].astype(np.float64)


def driven_summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the keys that a run of sutures adds to its summary; None if nothing was driven."""
    setup = setup_of(trials[0])
    errors = np.concatenate([joint_errors(trial) for trial in trials])
    scores = [score for trial in trials for score in trial.scores]
    return {
        "sutures": [{"theta_deg": s["theta_deg"], "direction": s["direction"]} for s in trials[0].scores],
        "joint_error_deg": {
            joint.name: rms_max(np.degrees(errors[:, index]))
            for index, joint in enumerate(setup.arm.joints)
            if not joint.prismatic
        },
        "insertion_error_mm": rms_max(1e3 * errors[:, 2]),
        "tip_error_mm": {
            "rms": _of(scores, "tip_rms_m", lambda v: float(np.sqrt(np.mean(v**2)))),
            "max": _of(scores, "tip_max_m", np.max),
        },
        "entry_error_mm": {"mean": _of(scores, "entry_error_m", np.mean), "max": _of(scores, "entry_error_m", np.max)},
        "exit_error_mm": {"mean": _of(scores, "exit_error_m", np.mean), "max": _of(scores, "exit_error_m", np.max)},
        "slip_mm": {"max": _of(scores, "slip_m", np.max)},
    }


def limits_shown(arm: ArmModel, index: int) -> tuple[float, float, float, str]:
    """Return lower and upper limit as shown, the scale from rad or m, and the unit."""
    joint = arm.joints[index]
    scale, unit = joint.shown_scale
    return scale * joint.lower, scale * joint.upper, scale, unit


def rms_max(errors: NDArray[np.float64]) -> dict[str, float | None]:
    """Return root mean square and largest magnitude of errors; None without errors."""
    if not len(errors):
        return {"rms": None, "max": None}
    return {"rms": float(np.sqrt(np.mean(errors**2))), "max": float(np.abs(errors).max())}


def _of(scores: Sequence[Mapping[str, Any]], key: str, of: Any) -> float | None:
    """Return a figure of the measurements in mm; None if there are none."""
    values = np.array([score[key] for score in scores if score[key] is not None], dtype=np.float64)
    return float(1e3 * of(values)) if len(values) else None
