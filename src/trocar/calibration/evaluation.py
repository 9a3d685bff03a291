"""Evaluation of a cable model: prediction errors on a recording, and time per compensation."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.compensation import Compensator
from trocar.calibration.models.base import CableModel
from trocar.calibration.recording import JOINT_NAMES, Recording
from trocar.geometry import shown
from trocar.notebook import table

TIMED_POINTS = 100


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of the joints without and with a cable model.

    Attributes:
        model: name of the model.
        recording: the recording, with ``valid`` true only in the scored rows.
        predicted: (n, 6) joints predicted by the model over the whole history.
        compensation_ms: median time of one compensation.
    """

    model: str
    recording: Recording
    predicted: NDArray[np.float64]
    compensation_ms: float

    def __repr__(self) -> str:
        errors = [float(np.degrees(np.linalg.norm(rmse[3:]))) for rmse in (self.rmse_before, self.rmse_after)]
        wrist = f"RMSE of the wrist {errors[0]:.2f} deg without it, {errors[1]:.2f} deg with it"
        return f"<Evaluation of model {self.model!r} on {self.rows} rows of {self.recording.name!r}: {wrist}>"

    def _repr_html_(self) -> str:
        units = ["m" if j == 2 else "rad" for j in range(6)]
        rows = [
            (name, shown(before, unit, ".3f"), shown(after, unit, ".3f"))
            for name, unit, before, after in zip(JOINT_NAMES, units, self.rmse_before, self.rmse_after, strict=True)
        ]
        return table(self, ("joint", "RMSE without model", "with model"), rows)

    @property
    def rows(self) -> int:
        """Return the number of scored rows."""
        return int(self.recording.valid.sum())

    @property
    def rmse_before(self) -> NDArray[np.float64]:
        """Return the RMSE (6,) of the commands against the measured joints, rad and m (q3)."""
        return self._rmse(self.recording.q_cmd)

    @property
    def rmse_after(self) -> NDArray[np.float64]:
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

    def _rmse(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
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
