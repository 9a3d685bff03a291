"""Pictures, tables and figures of driven sutures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from trocar.eval import TaskReport, in_words, stopped
from trocar.geometry import SE3, TURN
from trocar.replay import Viewpoint
from trocar.report.tables import figure
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.report.driven import draw_joints, draw_needle, driven_summary, setup_of, steps_of

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

UNSHOWN = ("lower", "withdraw", "rise")
"""Steps of a suture without a picture."""

APART_S = 0.5
"""A step that ends this shortly before the end of the first suture looks the same."""

REACH, RISE_M = 1.25, 0.018
"""A picture's frame: this many radii of the circle, and as high over the phantom as a needle in the jaws."""


class SutureReport(TaskReport):
    """What a report of driven sutures adds."""

    view = Viewpoint((0.12, 0.23, 0.17), 0.37)
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
        way = "clockwise" if score["direction"] > 0 else "counterclockwise"
        return f"at {score['theta_deg']:.0f} deg, {way}"

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
        for number, score in enumerate(trial.scores, start=1):
            how = in_words(score["failure"]) or "driven"
            found.append((f"suture {number}, {score['theta_deg']:.0f} deg: {how}", self.failed_s(trial, score)))
        return sorted(found, key=lambda item: item[1])

    def pictures(self, folder: Path, trials: Sequence[Trial]) -> list[Path]:
        """Draw joints and needle of the first trial against the plan."""
        trial = trials[0]
        what = trial.about["method"]
        arm = trial.about["arms"][0]
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
            table.add_row(what, figure(error["rms"]) if "rms" in error else "", figure(error["max"]))
        return [table]

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what stopped a trial, and what is modelled."""
        reasons = [stopped(trial.events)[1] for trial in trials]
        return [*filter(None, reasons), *MODELLED]


MODELLED = (
    "no tissue mechanics: the phantom carries the needle and slows it by viscous drag, and is not solid",
    "the jaws hold the needle by friction; a person pulls it out and loads it again, exactly, before each suture",
)
"""What a reader of the figures must know; printed with them."""
