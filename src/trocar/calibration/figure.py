"""Figure of an evaluation: joints over time, and hysteresis loops."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trocar.calibration.evaluation import Evaluation
from trocar.calibration.recording import JOINT_NAMES
from trocar.output import write_figure

if TYPE_CHECKING:
    pass

JOINT_TITLES = ("q1 outer yaw", "q2 outer pitch", "q3 insertion", "q4 roll", "q5 wrist pitch", "q6 wrist yaw")
COLOURS = {"commanded": "#8a8f98", "measured": "#1f6fb4", "predicted": "#d9541e"}
LOOP_ROWS = 160


def draw_evaluation(evaluation: Evaluation, path: str | Path) -> Path:
    """Draw the wrist's joints over time on the left and hysteresis on the right; return the path of the picture.

    The right column shows the error over the command, which forms a loop since it depends on where the joint came from.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 (slow to import, and only this picture needs it)

    recording = evaluation.recording
    rows = np.flatnonzero(recording.valid)
    t_s = recording.t_s[rows] - recording.t_s[rows[0]]
    loop = rows[:LOOP_ROWS]
    figure = Figure(figsize=(14, 9), layout="constrained", dpi=110)
    axes = figure.subplots(3, 2, width_ratios=(2.6, 1))
    for row, joint in enumerate((3, 4, 5)):
        over_time, loops = axes[row]
        lines = {
            "commanded": recording.q_cmd[:, joint],
            "measured": recording.q_phy[:, joint],
            "predicted": evaluation.predicted[:, joint],
        }
        for label, values in lines.items():
            style = "--" if label == "predicted" else "-"
            over_time.plot(t_s, values[rows], style, color=COLOURS[label], lw=1.3, label=label)
            if label != "commanded":
                error = values - recording.q_cmd[:, joint]
                loops.plot(
                    recording.q_cmd[loop, joint],
                    error[loop],
                    style,
                    color=COLOURS[label],
                    lw=1.0,
                    label=label,
                )
        before, after = evaluation.rmse_before[joint], evaluation.rmse_after[joint]
        over_time.set_title(f"{JOINT_TITLES[joint]}: RMSE {before:.4f} rad uncorrected, {after:.4f} rad predicted")
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
    figure.suptitle(f"{recording.name}: cable model '{evaluation.model}' on {evaluation.rows} rows")
    return write_figure(path, figure)
