"""Pictures, tables and figures of driven sutures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from trocar.replay import Viewpoint
from trocar.report.tables import figure
from trocar.tasks.kit import TaskReport, stopped
from trocar.tasks.suture.report.driven import driven_summary, steps_of
from trocar.tasks.suture.report.driven_figures import draw_joints, draw_needle

if TYPE_CHECKING:
    from trocar.trials.trial import Trial

UNSHOWN = ("lower", "withdraw")
"""Steps of a suture without a picture."""


class SutureReport(TaskReport):
    """What a report of driven sutures shows besides the usual."""

    view = Viewpoint((0.12, 0.23, 0.17), (-0.002, 0.0, 0.008), 0.37)
    colours: Mapping[str, tuple[float, float, float]] = {"needle": (0.05, 0.25, 0.85)}
    parts = ("planning", "loading", "motion", "jaw", "settling")

    def moments(self, trial: Trial) -> list[tuple[str, float]]:
        """Return the end of each step of the first suture, then of each suture."""
        found = [(name, end_s) for name, _, end_s in steps_of(trial, 0) if name not in UNSHOWN]
        for number, score in enumerate(trial.scores, start=1):
            how = score["failure"].lower().replace("_", " ") or "driven"
            if number > 1 or score["failure"]:
                found.append((f"suture {number} at {score['theta_deg']:.0f} deg: {how}", score["end_s"]))
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
        for joint, error in summary["joint_error_deg"].items():
            table.add_row(f"{joint.replace('_', ' ')}, deg", figure(error["rms"]), figure(error["max"]))
        insertion, tip = summary["insertion_error_mm"], summary["tip_error_mm"]
        table.add_row("insertion, mm", figure(insertion["rms"]), figure(insertion["max"]))
        table.add_row("needle's tip off its path, mm", figure(tip["rms"]), figure(tip["max"]))
        for end in ("entry", "exit"):
            table.add_row(f"{end} off its point, mm", "", figure(summary[f"{end}_error_mm"]["max"]))
        table.add_row("slip in the jaws, mm", "", figure(summary["slip_mm"]["max"]))
        return [table]

    def notes(self, trials: Sequence[Trial]) -> list[str]:
        """Return what stopped a trial, and what is modelled."""
        reasons = [stopped(trial.events)[1] for trial in trials]
        return [*filter(None, reasons), *MODELLED]


MODELLED = (
    "no tissue mechanics: the phantom bears the needle and drags on it (viscous), and is solid to nothing",
    "the jaws hold the needle by friction; a person pulls it out and loads it again, exactly, before each suture",
)
"""What a reader of the figures must know; printed with them."""
