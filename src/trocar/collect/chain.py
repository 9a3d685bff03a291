"""Collect, register, fit, evaluate: the calibration of one arm, from the first image to the cable model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trocar.calibration.evaluation import Evaluation, evaluate
from trocar.calibration.models import MODELS, save_model
from trocar.calibration.recording import Recording
from trocar.collect.collection import Collection, Listener
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.perception.fiducial_joints import Measured, distance_errors_m


@dataclass(frozen=True, eq=False)
class Calibrated:
    """One arm, calibrated from images."""

    collection: Collection  # what was collected
    measured: Measured  # base and joints found in its images
    recording: Recording  # commands and measured joints
    # of the cable model on the part of the recording that it was not fitted on; None: none was fitted
    evaluation: Evaluation | None
    fitted_rows: int  # rows at the beginning that the model was fitted on

    @property
    def joint_error(self) -> Array:
        """Return measured minus true joints (m, 6) of the good rows; the simulator's truth is used for this alone."""
        return (self.recording.q_phy - self.collection.q_joint)[self.recording.valid]

    @property
    def distance_error_m(self) -> Array:
        """Return by how much distances between spheres of one part differ from those printed, as a flat array."""
        errors = distance_errors_m(self.collection.fixture, self.measured.p_camera_m)
        return errors[np.isfinite(errors)]

    def base_error(self, T_camera_base: SE3) -> tuple[float, float]:
        """Return the error of the base's pose in the camera frame: distance in m, angle in rad."""
        off = T_camera_base.inverse() @ self.measured.hand_eye.T_camera_base
        turn = float(np.arccos(np.clip((np.trace(off.rotation.matrix) - 1) / 2, -1, 1)))
        return float(np.linalg.norm(off.translation_m)), turn

    def summary(self, T_camera_base: SE3) -> dict[str, Any]:
        """Return the figures of the report as JSON's values; ``T_camera_base`` is the true one."""
        eye, collection = self.measured.hand_eye, self.collection
        off_m, turned_rad = self.base_error(T_camera_base)
        found: dict[str, Any] = {
            "rows": len(self.recording),
            "good_rows": int(self.recording.valid.sum()),
            "flags": self.measured.counts(),
            "simulated_minutes": round(collection.duration_s / 60, 3),
            "sphere_distance_rms_mm": 1e3 * self.measured.distance_rms_m,
            "joint_rms": _rms(self.joint_error).tolist(),
            "registration": {
                "rms_mm": 1e3 * eye.rms_m,
                "used": eye.used,
                "rejected": eye.rejected,
                "off_mm": 1e3 * off_m,
                "off_deg": float(np.degrees(turned_rad)),
            },
        }
        if self.evaluation is not None:
            held_out = self.evaluation.recording.valid
            predicted = (self.evaluation.predicted - collection.q_joint)[held_out]
            found["model"] = {
                "name": self.evaluation.model,
                "fitted_rows": self.fitted_rows,
                "held_out_rows": self.evaluation.rows,
                "rmse_before": self.evaluation.rmse_before.tolist(),
                "rmse_after": self.evaluation.rmse_after.tolist(),
                "rmse_after_true": _rms(predicted).tolist(),
            }
        return found


def calibrate(
    collection: Collection,
    folder: str | Path,
    *,
    model: str | None = "play",
    fraction: float = 0.8,
    rng: np.random.Generator,
    listener: Listener | None = None,
) -> Calibrated:
    """Collect what is still missing, and write recording and cable model of one arm into a folder.

    Args:
        collection: of the arm.
        folder: gets ``spheres_ARM.npz``, ``recording_ARM.npz`` and ``cables_ARM.npz``.
        model: cable model, fitted on the first rows; None: none.
        fraction: share of the rows that it is fitted on; the rest is for its evaluation.
        rng: of the fit.
        listener: called after each row.
    """
    folder = Path(folder)
    arm = collection.arm
    measured = collection.measured(collection.run(folder / f"spheres_{arm}.npz", listener))
    recording = collection.recording(measured)
    recording.save(folder / f"recording_{arm}.npz")
    rows, evaluation = int(fraction * len(recording)), None
    if model is not None:
        fitted = MODELS.pick(model).fit(recording.first(rows), rng)
        save_model(fitted, folder / f"cables_{arm}.npz")
        evaluation = evaluate(fitted, recording, rows)
    return Calibrated(collection, measured, recording, evaluation, rows)


def _rms(errors: Array) -> Array:
    return np.sqrt(np.mean(errors**2, axis=0))
