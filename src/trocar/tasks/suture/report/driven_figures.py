"""Pictures of driven sutures: joints over time against the plan and their limits, the needle's tip against its path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from trocar.eval import in_words
from trocar.eval.trial import Trial
from trocar.geometry import SE3, TURN
from trocar.report import style
from trocar.report.tables import figure as figures
from trocar.tasks.suture.report.driven import arm_of, joint_errors, limits_shown, rms_max, setup_of, steps_of, suture_of

NEAR = 0.15
"""A limit is drawn if the joint comes closer to it than this share of its range."""


def draw_joints(trial: Trial, path: Path, title: str = "Joints driven and planned") -> Path:
    """Draw each joint over time, driven and as planned, with the error below; return the path.

    Args:
        trial: of sutures.
        path: of the picture.
        title: above it.
    """
    arm, name = setup_of(trial).arm, arm_of(trial)
    times, q, asked = trial.times_s, trial.arrays[f"true_{name}"], trial.arrays[f"asked_{name}"]
    spans = [(number, *step) for number in range(len(trial.scores)) for step in steps_of(trial, number)]
    first, last = min((s[2] for s in spans), default=0.0), max((s[3] for s in spans), default=float(times[-1]))
    shown = (times >= first) & (times <= last)
    while_driven = joint_errors(trial)
    with style.figure(10.0, 9.0, path) as figure:
        grid = figure.subplots(6, 2, sharex=True, width_ratios=[2, 1])
        for index, joint in enumerate(arm.joints):
            lower, upper, scale, unit = limits_shown(arm, index)
            left, right = grid[index]
            left.plot(times, scale * asked[:, index], color=style.ORANGE, linewidth=2.2, label="planned")
            left.plot(times, scale * q[:, index], color=style.BLUE, linewidth=0.9, label="driven")
            values = scale * q[shown, index]
            for limit in (lower, upper):
                if len(values) and np.abs(values - limit).min() < NEAR * (upper - lower):
                    left.axhline(limit, color=style.VERMILION, linewidth=1.0, linestyle="--")
            left.set_ylabel(f"{joint.name.replace('_', ' ')}\n{unit}")
            error_unit = "mm" if joint.prismatic else "deg"
            error = scale * (q - asked)[shown, index]  # only over the time shown, because earlier values are larger
            right.plot(times[shown], error, color=style.PURPLE, linewidth=0.7)
            right.axhline(0.0, color=style.QUIET, linewidth=0.6)
            right.set_ylabel(f"driven less\nplanned {error_unit}")
            of_joint = rms_max(scale * while_driven[:, index])
            said = f"shaded: RMS {figures(of_joint['rms'])}, largest {figures(of_joint['max'])} {error_unit}"
            right.set_title(said, loc="right", fontsize=8, fontweight="normal")
            for axes in (left, right):
                _shade(axes, spans)
        grid[0, 0].set_title(title)
        grid[0, 0].legend(loc="upper right", ncols=2)
        grid[-1, 0].set_xlabel("time, s; shaded: the primitive")
        grid[-1, 1].set_xlabel("time, s")
        grid[0, 0].set_xlim(first, last)
        figure.align_ylabels(grid[:, 0])
        figure.align_ylabels(grid[:, 1])
    return path


def _shade(axes: Axes, spans: list[tuple[int, str, float, float]]) -> None:
    """Mark the time in which a needle was driven."""
    for _, step, start, end in spans:
        if step.startswith(("penetrate", "rotate", "push", "regrasp")):
            axes.axvspan(start, end, color=style.FAINT, alpha=0.9 if not step.startswith("regrasp") else 0.45, zorder=0)


def draw_needle(trial: Trial, path: Path, title: str = "Path of the needle's tip") -> Path:
    """Draw the needle's tip beside its plan, from above, and along and below the surface; return the path.

    Args:
        trial: of sutures.
        path: of the picture.
        title: above it.
    """
    setup = setup_of(trial)
    T_circle_world = SE3(trial.arrays["T_world_circle"].astype(np.float64)).inverse()
    T_circle_needle = T_circle_world @ trial.replay().T_world_body["needle"]
    tips = 1e3 * T_circle_needle.apply([0.0, -setup.needle.radius_m, 0.0])
    times = trial.times_s
    scores: list[dict[str, Any]] = trial.scores
    count = max(1, len(scores))
    with style.figure(10.0, 7.2, path) as figure:
        grid = figure.add_gridspec(count, 2, width_ratios=[1.25, 1])
        above = figure.add_subplot(grid[:, 0])
        angle = np.linspace(0.0, TURN, 361)
        radius = 1e3 * setup.circle.radius_m
        above.plot(radius * np.cos(angle), radius * np.sin(angle), color=style.QUIET, linewidth=0.8, linestyle=":")
        for number, score in enumerate(scores):
            side = figure.add_subplot(grid[number, 1])
            suture = suture_of(trial, score)
            planned = 1e3 * suture.needle_path_m
            entry = planned[0]
            heading = planned[-1, :2] - entry[:2]
            heading /= np.linalg.norm(heading)
            above.plot(planned[:, 0], planned[:, 1], color=style.ORANGE, linewidth=3.0)
            side.plot((planned[:, :2] - entry[:2]) @ heading, planned[:, 2], color=style.ORANGE, linewidth=3.0)
            driven = [(a, b) for step, a, b in steps_of(trial, number) if step.startswith(("pen", "rot", "push"))]
            rows = np.zeros(len(times), dtype=bool)
            for a, b in driven:
                rows |= (times >= a) & (times <= b)
            shown = np.where(rows[:, None], tips, np.nan)
            above.plot(shown[:, 0], shown[:, 1], color=style.BLUE, linewidth=1.0)
            side.plot((shown[:, :2] - entry[:2]) @ heading, shown[:, 2], color=style.BLUE, linewidth=1.0)
            side.axhline(0.0, color=style.QUIET, linewidth=0.8)
            side.set_aspect("equal", adjustable="datalim")
            side.set_ylabel("height, mm")
            how = in_words(score["failure"]) or "in and out within 1 mm"
            side.set_title(f"suture {number + 1}, {score['theta_deg']:.0f} deg: {how}", fontsize=9)
            if number == count - 1:
                side.set_xlabel("along the suture from its entry, mm")
            off = 1.28 * radius
            above.text(
                off * np.cos(suture.theta_rad),
                off * np.sin(suture.theta_rad),
                f"{number + 1}\n{score['theta_deg']:.0f} deg",
                ha="center",
                va="center",
                fontweight="bold",
            )
        above.plot([], [], color=style.ORANGE, linewidth=3.0, label="planned")
        above.plot([], [], color=style.BLUE, linewidth=1.0, label="driven")
        above.legend(loc="center")
        above.update_datalim([(-1.4 * radius, -1.4 * radius), (1.4 * radius, 1.4 * radius)])
        above.autoscale_view()
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("x of the circle, mm")
        above.set_ylabel("y of the circle, mm")
        above.set_title(title)
    return path
