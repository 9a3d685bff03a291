"""Calibrate one arm from images: measure its joints, fit and evaluate a cable model, draw picture and table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.table import Table

from trocar.calibration.evaluation import Evaluation, draw_evaluation, evaluate
from trocar.calibration.models import MODELS, save_model
from trocar.calibration.recording import JOINT_NAMES, Recording
from trocar.collect.checkerboard import apart
from trocar.collect.collection import Collection
from trocar.collect.plan import CollectionPlan
from trocar.files.output import write_figure
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.perception.depth import project
from trocar.perception.fiducial_joints import Measured, distance_errors_m

DISTANCE_TARGET_MM, JOINT_TARGET_RAD = 0.35, 0.01
"""Targets: RMS error of distances between spheres, and of the measured joints (the paper: .32 mm, below .01 rad)."""
BRIGHTER = 1.6


@dataclass(frozen=True, eq=False)
class Calibrated:
    """One arm, calibrated from images."""

    collection: CollectionPlan
    measured: Measured  # base and joints found in its images
    recording: Recording
    evaluation: Evaluation | None  # of the cable model on what it was not fitted on; None: none was fitted
    fitted_rows: int  # rows at the beginning that the model was fitted on

    @property
    def distance_error_m(self) -> Array:
        """Return measured minus printed distances between spheres of one part, as a flat array."""
        errors = distance_errors_m(self.collection.fixture, self.measured.p_camera_m)
        return errors[np.isfinite(errors)]

    def error(self, q: Array) -> Array:
        """Return measured joints minus these (n, 6), for the good rows (m, 6)."""
        return (self.recording.q_phy - q)[self.recording.valid]

    def summary(self) -> dict[str, Any]:
        """Return the report's figures as JSON values; ``off_*`` compare the base with the one registered before."""
        shaft, recording = self.measured.shaft, self.recording
        used = int(shaft.inliers.sum())
        registration = {"rms_mm": 1e3 * shaft.rms_m, "used": used, "rejected": len(shaft.inliers) - used}
        found: dict[str, Any] = {
            "rows": len(recording),
            "good_rows": int(recording.valid.sum()),
            "flags": self.measured.counts(),
            "minutes": round(float(recording.t_s[-1]) / 60, 3),
            "sphere_distance_rms_mm": 1e3 * self.measured.distance_rms_m,
            "commanded_rms": _rms(self.error(recording.q_cmd)).tolist(),
            "registration": registration | _off(self.collection.view.T_camera_base, self.measured.T_camera_base),
        }
        if self.evaluation is not None:
            found["model"] = {
                "name": self.evaluation.model,
                "fitted_rows": self.fitted_rows,
                "held_out_rows": self.evaluation.rows,
                "rmse_before": self.evaluation.rmse_before.tolist(),
                "rmse_after": self.evaluation.rmse_after.tolist(),
            }
        return found

    def drawn(self, folder: str | Path) -> tuple[dict[str, Any], list[Path]]:
        """Draw pictures into a folder; return the figures, against the truth if it is known, and the other files."""
        folder, arm, files = Path(folder), self.collection.arm, []
        if isinstance(self.collection, Collection):
            files.append(draw_calibration(self, self.collection, folder / f"calibration_{arm}.png"))
        if self.evaluation is not None:
            files += [folder / f"cables_{arm}.npz", draw_evaluation(self.evaluation, folder / f"loops_{arm}.png")]
        return self.judged(self.collection) if isinstance(self.collection, Collection) else self.summary(), files

    def judged(self, truth: Collection) -> dict[str, Any]:
        """Return the summary with errors against the simulator's truth, not against commands and registration."""
        found = self.summary()
        found["simulated_minutes"] = found.pop("minutes")
        found["joint_rms"] = _rms(self.error(truth.q_joint)).tolist()
        del found["commanded_rms"]
        found["registration"] |= _off(truth.T_camera_base_true, self.measured.T_camera_base)
        if self.evaluation is not None:
            predicted = (self.evaluation.predicted - truth.q_joint)[self.evaluation.recording.valid]
            found["model"]["rmse_after_true"] = _rms(predicted).tolist()
        return found


def calibrated(
    collection: CollectionPlan,
    centers: Array,
    folder: str | Path,
    *,
    model: str | None = "play",
    fraction: float = 0.8,
    rng: np.random.Generator,
) -> Calibrated:
    """Measure one arm's joints, fit a cable model, and write both into a folder.

    Args:
        collection: commands and view of the arm.
        centers: (n, k, 3) centres of the spheres in all rows.
        folder: gets ``recording_ARM.npz`` and ``cables_ARM.npz``.
        model: name of the cable model, fitted on the first rows; None: none is fitted.
        fraction: share of the rows that the model is fitted on; the rest is for its evaluation.
        rng: random numbers for the fit.
    """
    folder, arm = Path(folder), collection.arm
    measured = collection.measured(centers)
    recording = collection.recording(measured)
    recording.save(folder / f"recording_{arm}.npz")
    rows, evaluation = int(fraction * len(recording)), None
    if model is not None:
        fitted = MODELS.pick(model).fit(recording.first(rows), rng)
        save_model(fitted, folder / f"cables_{arm}.npz")
        evaluation = evaluate(fitted, recording, rows)
    return Calibrated(collection, measured, recording, evaluation, rows)


def draw_calibration(found: Calibrated, truth: Collection, path: str | Path) -> Path:
    """Draw an image with the spheres found, histograms of errors, and the wrist's errors over time."""
    figure = Figure(figsize=(14, 8), layout="constrained", dpi=110)
    grid = figure.add_gridspec(2, 3)
    _draw_image(figure.add_subplot(grid[0, 0]), found, truth)
    distances, outer, wrist = (figure.add_subplot(grid[place]) for place in ((0, 1), (0, 2), (1, slice(None))))
    error = found.error(truth.q_joint)
    names = [
        f"{JOINT_NAMES[joint]}: {' '.join(_joint_error(joint, rms))} RMS"
        for joint, rms in enumerate(_rms(error).tolist())
    ]
    distances.hist(1e3 * found.distance_error_m, bins=60, color="#1f6fb4")
    distances.set_title(f"distances between spheres: {1e3 * found.measured.distance_rms_m:.2f} mm RMS")
    distances.set_xlabel("measured - printed [mm]")
    for joint in range(3):
        outer.hist(1e3 * error[:, joint], bins=60, histtype="step", lw=1.4, label=names[joint])
    outer.set_title("outer joints")
    outer.set_xlabel("measured - true [mrad, mm]")
    outer.legend(loc="upper right")
    for joint in (3, 4, 5):
        minutes = found.recording.t_s[found.recording.valid] / 60
        wrist.plot(minutes, error[:, joint], ".", ms=3, label=names[joint])
    for edge in (-JOINT_TARGET_RAD, JOINT_TARGET_RAD):
        wrist.axhline(edge, color="#8a8f98", lw=1.0, ls="--")
    wrist.set_title("wrist: measured - true joints (dashed: the limit on the RMS)")
    wrist.set_xlabel("time on the robot [min]")
    wrist.set_ylabel("[rad]")
    wrist.legend(loc="upper right", ncols=3)
    for axes in (distances, outer, wrist):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    good = f"{int(found.recording.valid.sum())} of {len(found.recording)} rows are good"
    figure.suptitle(f"{found.collection.arm}: {good}")
    return write_figure(path, figure)


def collection_table(arms: dict[str, dict[str, Any]]) -> Table:
    """Return a table of all arms' figures and the targets; errors are against the truth where it is known."""
    table = Table(title="calibration from images")
    table.add_column("", justify="left")
    for name in (*arms, "must hold"):
        table.add_column(name, justify="right")
    every = list(arms.values())
    simulated = all("joint_rms" in a for a in every)
    joints, minutes = ("joint_rms", "simulated_minutes") if simulated else ("commanded_rms", "minutes")
    than, off = ("true", "base off") if simulated else ("commanded", "base off the one registered before")
    table.add_row("good rows", *(f"{a['good_rows']} of {a['rows']}" for a in every), "")
    table.add_row("time on the robot, min", *(f"{a[minutes]:.1f}" for a in every), "18 for 1355" if simulated else "")
    distances = (f"{a['sphere_distance_rms_mm']:.2f}" for a in every)
    table.add_row("sphere distances, mm RMS", *distances, f"{DISTANCE_TARGET_MM:g}")
    for joint, name in enumerate(JOINT_NAMES):
        shown = [_joint_error(joint, a[joints][joint]) for a in every]
        limit = f"{JOINT_TARGET_RAD:g}" if simulated and name != "q3" else ""
        table.add_row(f"{name} measured - {than}, {shown[0][1]} RMS", *(value for value, _ in shown), limit)
    registrations = [a["registration"] for a in every]
    table.add_row(f"{off}, mm", *(f"{r['off_mm']:.2f}" for r in registrations), "")
    table.add_row(f"{off}, deg", *(f"{r['off_deg']:.3f}" for r in registrations), "")
    if all("model" in a for a in every):
        for joint in (3, 4, 5):
            both = ((a["model"]["rmse_before"][joint], a["model"]["rmse_after"][joint]) for a in every)
            table.add_row(f"{JOINT_NAMES[joint]} held out, rad RMSE", *(f"{b:.4f} -> {c:.4f}" for b, c in both), "")
    return table


def _draw_image(axes: Axes, found: Calibrated, truth: Collection) -> None:
    """Draw the image of the middle good row, with an outline round each accepted sphere."""
    rows = np.flatnonzero(found.recording.valid)
    row = int(rows[len(rows) // 2])
    image = truth.image(row)
    axes.imshow(cv2.convertScaleAbs(image.color, alpha=BRIGHTER))
    centers = found.measured.p_camera_m[row]
    for center, radius in zip(centers, found.collection.fixture.radii_m, strict=True):
        if np.isfinite(center).all():
            u, v = project(image.intrinsics, center)
            outline = radius * image.intrinsics.fx / center[2]
            axes.add_patch(Circle((u, v), outline, fill=False, color="white", lw=1.0, ls="--"))
    axes.set_title(f"row {row}: spheres found")
    axes.set_axis_off()


def _joint_error(joint: int, error: float) -> tuple[str, str]:
    """Return the error of a joint, rad or m, as shown in pictures and tables, and its unit."""
    return (f"{1e3 * error:.2f}", "mm") if JOINT_NAMES[joint] == "q3" else (f"{error:.4f}", "rad")


def _rms(errors: Array) -> Array:
    return np.sqrt(np.mean(errors**2, axis=0))


def _off(T_camera_base: SE3, found: SE3) -> dict[str, float]:
    """Return how far a base was found from another pose, in mm and deg."""
    return {f"off_{unit}": by for unit, by in apart(T_camera_base, found).items()}
