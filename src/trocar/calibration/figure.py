"""Figure of an evaluation: joints over time, and hysteresis loops."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trocar.calibration.evaluation import Evaluation
from trocar.calibration.recording import JOINT_NAMES, Recording
from trocar.errors import InvalidInput
from trocar.files.output import write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JOINT_TITLES = ("q1 outer yaw", "q2 outer pitch", "q3 insertion", "q4 roll", "q5 wrist pitch", "q6 wrist yaw")
COLOURS = {"commanded": "#8a8f98", "measured": "#1f6fb4", "predicted": "#d9541e"}
LOOP_ROWS = 160


def draw_evaluation(evaluation: Evaluation, path: str | Path) -> Path:
    """Draw :func:`wrist` of an evaluation and return the path of the picture."""
    from matplotlib.figure import Figure  # slow to import, and only this picture needs it

    figure = Figure(layout="constrained", dpi=110)
    wrist(figure, evaluation.recording, evaluation)
    return write_figure(path, figure)


def wrist(figure: Figure, recording: Recording, evaluation: Evaluation | None = None) -> None:
    """Draw the wrist's joints over time on the left and hysteresis on the right.

    The right column shows the error over the command, which forms a loop since it depends on where the joint came from.

    Args:
        figure: empty.
        recording: its valid rows are drawn.
        evaluation: of a model on this recording, whose predictions are drawn too; None: no model.

    Raises:
        TrocarError: no row is valid.
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
        error = (recording.q_phy - recording.q_cmd)[recording.valid, joint]
        return f"RMSE {np.sqrt(np.mean(error**2)):.4f} rad, measured against commanded"
    before, after = evaluation.rmse_before[joint], evaluation.rmse_after[joint]
    return f"RMSE {before:.4f} rad uncorrected, {after:.4f} rad predicted"
