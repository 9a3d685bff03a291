"""Evaluation of cable models: errors on a recording, also after a refit, time per compensation, and a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from trocar.calibration.compensation import Compensator
from trocar.calibration.models.base import CableModel
from trocar.calibration.recording import JOINT_NAMES, JOINT_UNITS, Recording
from trocar.errors import InvalidInput
from trocar.files.output import write_figure
from trocar.geometry import shown
from trocar.geometry.arrays import Array
from trocar.notebook import table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIMED_POINTS = 100
REFIT_ROWS = 30  # number of samples for a refit of the offsets: half a minute on the robot
JOINT_TITLES = ("q1 outer yaw", "q2 outer pitch", "q3 insertion", "q4 roll", "q5 wrist pitch", "q6 wrist yaw")
COLOURS = {"commanded": "#8a8f98", "measured": "#1f6fb4", "predicted": "#d9541e"}
LOOP_ROWS = 160
Model = TypeVar("Model", bound=CableModel)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of the joints without and with a cable model."""

    model: str  # name of the model
    recording: Recording  # the recording, with ``valid`` true only in the scored rows
    predicted: Array  # (n, 6) joints predicted by the model over the whole history
    compensation_ms: float  # median time of one compensation

    def __repr__(self) -> str:
        errors = [float(np.degrees(np.linalg.norm(rmse[3:]))) for rmse in (self.rmse_before, self.rmse_after)]
        wrist = f"RMSE of the wrist {errors[0]:.2f} deg without it, {errors[1]:.2f} deg with it"
        return f"<Evaluation of model {self.model!r} on {self.rows} rows of {self.recording.name!r}: {wrist}>"

    def _repr_html_(self) -> str:
        errors = self.rmse_before, self.rmse_after
        rows = [
            (name, shown(before, unit, ".3f"), shown(after, unit, ".3f"))
            for name, unit, before, after in zip(JOINT_NAMES, JOINT_UNITS, *errors, strict=True)
        ]
        return table(self, ("joint", "RMSE without model", "with model"), rows)

    @property
    def rows(self) -> int:
        """Return the number of scored rows."""
        return int(self.recording.valid.sum())

    @property
    def rmse_before(self) -> Array:
        """Return the RMSE (6,) of the commands against the measured joints, rad and m (q3)."""
        return self._rmse(self.recording.q_cmd)

    @property
    def rmse_after(self) -> Array:
        """Return the RMSE (6,) of the model's prediction against the measured joints, rad and m (q3)."""
        return self._rmse(self.predicted)

    def summary(self) -> dict[str, object]:
        """Return what ``trocar calibrate evaluate --json`` prints."""
        return {
            "model": self.model,
            "recording": self.recording.name,
            "joints": list(JOINT_NAMES),
            "rmse_before": self.rmse_before.tolist(),
            "rmse_after": self.rmse_after.tolist(),
            "rows": self.rows,
            "compensation_ms": self.compensation_ms,
        }

    def _rmse(self, joints: Array) -> Array:
        error = (self.recording.q_phy - joints)[self.recording.valid]
        return np.sqrt(np.mean(error**2, axis=0))


def evaluate(model: CableModel, recording: Recording, from_row: int = 0) -> Evaluation:
    """Return the model's errors on the valid rows from ``from_row`` on; its memory is built up over all rows."""
    scored = recording.scored(from_row)
    return Evaluation(model.name, scored, model.predict(recording.q_cmd), compensation_time_ms(model, recording))


def compensation_time_ms(model: CableModel, recording: Recording) -> float:
    """Return the median time of one compensation, with the recording's commands as the desired path."""
    compensator = Compensator(model)
    compensator.start(recording.q_cmd[0])
    times = []
    for q in recording.q_cmd[:TIMED_POINTS]:
        start = time.perf_counter()
        compensator.path(q[None])
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def refit_offset(model: Model, recording: Recording, rows: int = REFIT_ROWS) -> Model:
    """Return the model with its offsets refitted on the first valid rows of a new session's recording.

    This is quick, but radii, gains and coupling change too (the flaw ``wear``): over three sessions of one instrument,
    the best constant offsets leave .017 .051 .036 rad. A minute of wide swings and a prior do better.

    Raises TrocarError: the recording has fewer valid rows than ``rows``.
    """
    good = np.flatnonzero(recording.valid)[:rows]
    if rows < 1 or len(good) < rows:
        problem = f"has {len(good)} valid rows, but a refit of the offsets needs {rows}"
        raise InvalidInput(recording.name, problem, "record more")
    error = recording.q_phy - model.predict(recording.q_cmd)
    return model.shifted(error[good].mean(axis=0))


def refit_ends(recording: Recording, rows: int = REFIT_ROWS) -> int:
    """Return the first row that a refit has not used; errors after a refit are evaluated from there."""
    return int(np.flatnonzero(recording.valid)[:rows][-1]) + 1


def draw_evaluation(evaluation: Evaluation, path: str | Path) -> Path:
    """Draw :func:`wrist` of an evaluation; return the path of the picture."""
    from matplotlib.figure import Figure  # slow to import, and only this picture needs it

    figure = Figure(layout="constrained", dpi=110)
    wrist(figure, evaluation.recording, evaluation)
    return write_figure(path, figure)


def wrist(figure: Figure, recording: Recording, evaluation: Evaluation | None = None) -> None:
    """Draw the wrist's joints over time on the left and hysteresis on the right.

    The right column shows the error over the command, which forms a loop since it depends on where the joint came from.
    Only valid rows are drawn, with a model's predictions if its ``evaluation`` on this recording is given.

    Raises TrocarError: no row is valid.
    """
    rows = np.flatnonzero(recording.valid)
    if not len(rows):
        raise InvalidInput(recording.name, f"has no valid row to be drawn ({recording.why_invalid()})")
    t_s = recording.t_s[rows] - recording.t_s[rows[0]]
    loop = rows[:LOOP_ROWS]
    figure.set_size_inches(14, 9)
    axes = figure.subplots(3, 2, width_ratios=(2.6, 1))
    for row, joint in enumerate((3, 4, 5)):
        over_time, loops = axes[row]
        lines = {"commanded": recording.q_cmd[:, joint], "measured": recording.q_phy[:, joint]}
        if evaluation is not None:
            lines["predicted"] = evaluation.predicted[:, joint]
        for label, values in lines.items():
            style = "--" if label == "predicted" else "-"
            over_time.plot(t_s, values[rows], style, color=COLOURS[label], lw=1.3, label=label)
            if label != "commanded":
                error = values - recording.q_cmd[:, joint]
                loops.plot(recording.q_cmd[loop, joint], error[loop], style, color=COLOURS[label], lw=1.0, label=label)
        over_time.set_title(f"{JOINT_TITLES[joint]}: {_errors(recording, evaluation, joint)}")
        over_time.set_ylabel(f"{JOINT_NAMES[joint]} [rad]")
        loops.set_ylabel(f"{JOINT_NAMES[joint]} - command [rad]")
        loops.set_title(f"hysteresis of {JOINT_NAMES[joint]}, first {len(loop)} rows")
        for axis in (over_time, loops):
            axis.grid(alpha=0.25)
            axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(loc="upper right", ncols=3, framealpha=0.9)
    axes[0, 1].legend(loc="best", framealpha=0.9)
    axes[2, 0].set_xlabel("time [s]")
    axes[2, 1].set_xlabel("commanded joint [rad]")
    model = "" if evaluation is None else f"cable model '{evaluation.model}' on "
    figure.suptitle(f"{recording.name}: {model}{len(rows)} rows")


def _errors(recording: Recording, evaluation: Evaluation | None, joint: int) -> str:
    """Return the RMSE of a joint in words."""
    if evaluation is None:
        error = recording.errors[recording.valid, joint]
        return f"RMSE {np.sqrt(np.mean(error**2)):.4f} rad, measured against commanded"
    before, after = evaluation.rmse_before[joint], evaluation.rmse_after[joint]
    return f"RMSE {before:.4f} rad uncorrected, {after:.4f} rad predicted"
