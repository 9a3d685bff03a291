"""Driven sutures in numbers, pictures and tables: true against desired joints, needle against its plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from trocar.eval import TaskReport, in_words, stopped
from trocar.eval.trial import Trial
from trocar.geometry import SE3, TURN
from trocar.replay import Viewpoint
from trocar.report import style
from trocar.report.tables import figure as figures
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import PRESETS, Suture, SutureSetup
from trocar.tasks.suture.planning.plan import setup_from
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES

NEAR = 0.15
"""A limit is drawn if the joint comes closer to it than this share of its range."""
DRIVING = ("penetrate", "rotate", "push")
"""Steps in which the jaws drive the needle; with the regrasps they are the primitive."""
UNSHOWN = ("lower", "withdraw", "rise")
"""Steps of a suture without a picture."""
APART_S = 0.5
"""A step that ends this shortly before the end of the first suture looks the same."""
REACH, RISE_M = 1.25, 0.018
"""A picture's frame: its radius in radii of the circle, and its height, that of a needle in the jaws."""
SECOND = ("grasp tip", "pull through", "hand over")
"""Steps that involve a second arm; pictures show the first time that each is done."""
NO_TISSUE = "no tissue mechanics: the phantom carries the needle and slows it by viscous drag, and is not solid"
BY_PERSON = (
    "the jaws hold the needle by friction; a person pulls it out and loads it again, exactly, before each suture"
)
BY_TWO_ARMS = "the jaws hold the needle by friction; a person set it up in its stand, and does not touch it after that"
"""What a reader of the figures must know; printed with them."""


def setup_of(trial: Trial) -> SutureSetup:
    """Return the geometry that a trial's sutures were planned for."""
    options = trial.about["options"]
    planned = options["plan_file"]
    return setup_from(planned["setup"]) if planned else PRESETS[str(options["preset"])].setup


def steps_of(trial: Trial, number: int) -> list[tuple[str, float, float]]:
    """Return (name, start, end in s) of the steps of a suture that the script noted."""
    steps = [event for event in trial.events if event["name"] == "step" and event["suture"] == number]
    begins = [float(event["time_s"]) for event in steps]
    ends = [*begins, float(trial.scores[number]["end_s"])][1:]
    return [(str(event["step"]), a, b) for event, a, b in zip(steps, begins, ends, strict=True)]


def joint_errors(trial: Trial) -> NDArray[np.float64]:
    """Return true minus desired joints (n, 6) at 100 Hz while primitives ran, rad and m."""
    times, rows = trial.times_s, np.zeros(len(trial.times_s), dtype=bool)
    for number in range(len(trial.scores)):
        inside = [step for step in steps_of(trial, number) if step[0].startswith((*DRIVING, "regrasp"))]
        if inside:
            rows |= (times >= inside[0][1]) & (times <= inside[-1][2])
    true, desired = _joints(trial)
    return (true - desired)[rows].astype(np.float64)


def _joints(trial: Trial) -> tuple[NDArray, NDArray]:
    """Return true and desired joints (n, 6) of the arm that drove."""
    arm = trial.about["arms"][0]
    return trial.arrays[f"true_{arm}"][:, :6], trial.arrays[f"desired_{arm}"][:, :6]


def driven_summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the keys that a run of sutures adds to its summary; None in them if nothing was driven."""
    errors = np.concatenate([joint_errors(trial) for trial in trials])
    scores = [score for trial in trials for score in trial.scores]

    def in_mm(key: str, **figures: Callable[[NDArray], Any]) -> dict[str, float | None]:
        values = np.array([score[key] for score in scores if score[key] is not None], dtype=np.float64)
        return {name: float(1e3 * of(values)) if len(values) else None for name, of in figures.items()}

    return {
        "sutures": [{"theta_deg": s["theta_deg"], "direction": s["direction"]} for s in trials[0].scores],
        "joint_error_deg": {
            joint.name: rms_max(np.degrees(errors[:, index]))
            for index, joint in enumerate(setup_of(trials[0]).arm.joints)
            if not joint.prismatic
        },
        "insertion_error_mm": rms_max(1e3 * errors[:, 2]),
        "tip_error_mm": {**in_mm("tip_rms_m", rms=_rms), **in_mm("tip_max_m", max=np.max)},
        "entry_error_mm": in_mm("entry_error_m", mean=np.mean, max=np.max),
        "exit_error_mm": in_mm("exit_error_m", mean=np.mean, max=np.max),
        "slip_mm": in_mm("slip_m", max=np.max),
    }


def rms_max(errors: NDArray[np.float64]) -> dict[str, float | None]:
    """Return root mean square and largest magnitude of errors; None without errors."""
    if not len(errors):
        return {"rms": None, "max": None}
    return {"rms": _rms(errors), "max": float(np.abs(errors).max())}


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def draw_joints(trial: Trial, path: Path, title: str) -> Path:
    """Draw each joint over time, driven and as planned, with the error beside it; return the path of the picture."""
    times, (q, desired) = trial.times_s, _joints(trial)
    spans = [step for number in range(len(trial.scores)) for step in steps_of(trial, number)]
    first, last = min((s[1] for s in spans), default=0.0), max((s[2] for s in spans), default=float(times[-1]))
    shown = (times >= first) & (times <= last)
    while_driven = joint_errors(trial)
    with style.figure(10.0, 9.0, path) as figure:
        grid = figure.subplots(6, 2, sharex=True, width_ratios=[2, 1])
        for index, joint in enumerate(setup_of(trial).arm.joints):
            scale, unit = joint.shown_scale
            left, right = grid[index]
            left.plot(times, scale * desired[:, index], color=style.ORANGE, linewidth=2.2, label="planned")
            left.plot(times, scale * q[:, index], color=style.BLUE, linewidth=0.9, label="driven")
            values = q[shown, index]
            for limit in (joint.lower, joint.upper):
                if len(values) and np.abs(values - limit).min() < NEAR * (joint.upper - joint.lower):
                    left.axhline(scale * limit, color=style.VERMILION, linewidth=1.0, linestyle="--")
            left.set_ylabel(f"{joint.name.replace('_', ' ')}\n{unit}")
            error = scale * (q - desired)[shown, index]  # only over the time shown, because earlier values are larger
            right.plot(times[shown], error, color=style.PURPLE, linewidth=0.7)
            right.axhline(0.0, color=style.QUIET, linewidth=0.6)
            right.set_ylabel(f"driven less\nplanned {unit}")
            of_joint = rms_max(scale * while_driven[:, index])
            said = f"shaded: RMS {figures(of_joint['rms'])}, largest {figures(of_joint['max'])} {unit}"
            right.set_title(said, loc="right", fontsize=8, fontweight="normal")
            for step, start, end in spans:
                if step.startswith((*DRIVING, "regrasp")):
                    alpha = 0.45 if step.startswith("regrasp") else 0.9
                    left.axvspan(start, end, color=style.FAINT, alpha=alpha, zorder=0)
                    right.axvspan(start, end, color=style.FAINT, alpha=alpha, zorder=0)
        grid[0, 0].set(title=title, xlim=(first, last))
        grid[0, 0].legend(loc="upper right", ncols=2)
        for column, label in enumerate(("time, s; shaded: the primitive", "time, s")):
            grid[-1, column].set_xlabel(label)
            figure.align_ylabels(grid[:, column])
    return path


def draw_needle(trial: Trial, path: Path, title: str) -> Path:
    """Draw the needle's tip beside its plan, from above, and along and below the surface; return the picture's path."""
    setup, scores = setup_of(trial), trial.scores
    T_circle_world = SE3(trial.arrays["T_world_circle"].astype(np.float64)).inverse()
    T_circle_needle = T_circle_world @ trial.replay().T_world_body["needle"]
    tips = 1e3 * T_circle_needle.apply(setup.needle.p_tip_m)
    count, radius = max(1, len(scores)), 1e3 * setup.circle.radius_m
    with style.figure(10.0, 7.2, path) as figure:
        grid = figure.add_gridspec(count, 2, width_ratios=[1.25, 1])
        above = figure.add_subplot(grid[:, 0])
        angle = np.linspace(0.0, TURN, 361)
        above.plot(radius * np.cos(angle), radius * np.sin(angle), color=style.QUIET, linewidth=0.8, linestyle=":")
        for number, score in enumerate(scores):
            suture = Suture(setup, float(np.radians(score["theta_deg"])), int(score["direction"]))
            side = figure.add_subplot(grid[number, 1])
            driven = np.zeros(len(tips), dtype=bool)
            for step, start, end in steps_of(trial, number):
                if step.startswith(DRIVING):
                    driven |= (trial.times_s >= start) & (trial.times_s <= end)
            planned = 1e3 * suture.needle_path_m
            heading = planned[-1, :2] - planned[0, :2]
            heading /= np.linalg.norm(heading)
            tip = np.where(driven[:, None], tips, np.nan)
            for points, color, width in ((planned, style.ORANGE, 3.0), (tip, style.BLUE, 1.0)):
                above.plot(points[:, 0], points[:, 1], color=color, linewidth=width)
                side.plot((points[:, :2] - planned[0, :2]) @ heading, points[:, 2], color=color, linewidth=width)
            side.axhline(0.0, color=style.QUIET, linewidth=0.8)
            side.set_aspect("equal", adjustable="datalim")
            how = in_words(score["failure"]) or "in and out within 1 mm"
            side.set_title(f"suture {number + 1}, {score['theta_deg']:.0f} deg: {how}", fontsize=9)
            side.set(ylabel="height, mm", xlabel="along the suture from its entry, mm" if number == count - 1 else "")
            x, y = 1.28 * radius * np.array([np.cos(suture.theta_rad), np.sin(suture.theta_rad)])
            label = f"{number + 1}\n{score['theta_deg']:.0f} deg"
            above.text(x, y, label, ha="center", va="center", fontweight="bold")
        above.plot([], [], color=style.ORANGE, linewidth=3.0, label="planned")
        above.plot([], [], color=style.BLUE, linewidth=1.0, label="driven")
        above.legend(loc="center")
        above.update_datalim([(-1.4 * radius, -1.4 * radius), (1.4 * radius, 1.4 * radius)])
        above.autoscale_view()
        above.set_aspect("equal", adjustable="datalim")
        above.set(xlabel="x of the circle, mm", ylabel="y of the circle, mm", title=title)
    return path


class SutureReport(TaskReport):
    """What a report of driven sutures adds."""

    view = Viewpoint((0.12, 0.23, 0.17))
    colours: Mapping[str, tuple[float, float, float]] = {"needle": (0.05, 0.25, 0.85)}
    parts = ("planning", "loading", "motion", "jaw", "settling")
    outcomes = SutureOutcome
    captions: Mapping[str, str] = {
        "joints": "Each joint over time, driven and planned; on the right, driven minus planned. Shaded: the needle "
        "primitive, for which RMS and largest error are given",
        "needle": "The needle's tip beside its planned path, from above, and along and below the surface",
    }

    def frame(self, trial: Trial) -> NDArray[np.float64]:
        """Return the circle and, above it, the height of a needle in the jaws."""
        angle = np.linspace(0.0, TURN, 24, endpoint=False)
        ring = REACH * setup_of(trial).circle.radius_m * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        T_world_circle = SE3(trial.arrays["T_world_circle"].astype(np.float64))
        return T_world_circle.apply(np.concatenate([ring, ring + [0.0, 0.0, RISE_M]]))

    def goal(self, score: Mapping[str, Any]) -> str:
        """Return the position on the circle, and the direction."""
        return f"at {score['theta_deg']:.0f} deg, {DIRECTION_NAMES[score['direction']]}"

    def measured(self, score: Mapping[str, Any]) -> Mapping[str, float | None]:
        """Return the errors of the needle."""
        found = {
            "entry off, mm": score["entry_error_m"],
            "exit off, mm": score["exit_error_m"],
            "tip off its path, RMS mm": score["tip_rms_m"],
            "slip, mm": score["slip_m"],
        }
        return {name: None if value is None else 1e3 * value for name, value in found.items()}

    def failed_s(self, trial: Trial, score: Mapping[str, Any]) -> float:
        """Return when the needle was driven last; the end, if it never was."""
        del trial
        return float(score["driven_s"][1] if score["driven_s"] else score["end_s"])

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the end of each step of the first suture, then the last time that each needle was driven."""
        if not trial.scores:
            return super().moments(trial)
        first = trial.scores[0]
        until_s = self.failed_s(trial, first) - APART_S
        found = [
            (f"{first['theta_deg']:.0f} deg: {name}", end_s)
            for name, _, end_s in steps_of(trial, 0)
            if name not in UNSHOWN and end_s < until_s
        ]
        second = [step for number in range(len(trial.scores)) for step in steps_of(trial, number) if step[0] in SECOND]
        found += [next((name, end_s) for name, _, end_s in second if name == each) for each in {s[0] for s in second}]
        for number, score in enumerate(trial.scores, start=1):
            how = in_words(score["failure"]) or "driven"
            found.append((f"suture {number}, {score['theta_deg']:.0f} deg: {how}", self.failed_s(trial, score)))
        return sorted(found, key=lambda item: item[1])

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw joints and needle of the first trial against the plan."""
        trial = trials[0]
        arm, what = trial.about["arms"][0], trial.about["method"]
        return [
            draw_joints(trial, folder / "joints.png", f"Joints of {arm} driven and planned, {what}"),
            draw_needle(trial, folder / "needle.png", f"Path of the needle's tip, {what}"),
        ]

    def summary(self, trials: Sequence[Trial]) -> dict[str, Any]:
        """Return driven joints and needle against the plan."""
        return driven_summary(trials)

    def tables(self, summary: Mapping[str, Any]) -> list[Table]:
        """Return how far driven joints and needle were from the plan."""
        table = Table(title=f"Driven against planned, {summary['method']}")
        table.add_column("what")
        table.add_column("RMS", justify="right")
        table.add_column("largest", justify="right")
        rows = {f"{joint.replace('_', ' ')}, deg": error for joint, error in summary["joint_error_deg"].items()}
        rows |= {
            "insertion, mm": summary["insertion_error_mm"],
            "needle's tip off its path, mm": summary["tip_error_mm"],
            "entry off its point, mm": summary["entry_error_mm"],
            "exit off its point, mm": summary["exit_error_mm"],
            "slip in the jaws, mm": summary["slip_mm"],
        }
        for what, error in rows.items():
            table.add_row(what, figures(error["rms"]) if "rms" in error else "", figures(error["max"]))
        return [table]

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what stopped a trial, and what is modelled."""
        reasons = [stopped(trial.events)[1] for trial in trials]
        by = BY_TWO_ARMS if len(trials[0].about["arms"]) > 1 else BY_PERSON
        return [*filter(None, reasons), NO_TISSUE, by]
