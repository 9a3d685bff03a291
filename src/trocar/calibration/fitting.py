"""Change of session: a quick refit of the offsets, which change most."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from trocar.calibration.models.base import CableModel
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput

REFIT_ROWS = 30
"""Number of samples for a refit of the offsets: half a minute on the robot."""

Model = TypeVar("Model", bound=CableModel)


def refit_offset(model: Model, recording: Recording, rows: int = REFIT_ROWS) -> Model:
    """Return the model with its offsets refitted on the first valid rows of a new session's recording.

    It is quick, but offsets are not all that changes: over three sessions of one instrument radii, gains and coupling
    differ too (the flaw ``wear``), and the best constant still leaves .017 .051 .036 rad. A minute of wide swings and a
    prior do better.

    Raises:
        TrocarError: the recording has fewer valid rows than that.
    """
    good = np.flatnonzero(recording.valid)[:rows]
    if rows < 1 or len(good) < rows:
        raise InvalidInput(
            recording.name, f"has {len(good)} valid rows, but a refit of the offsets needs {rows}", "record more"
        )
    error = recording.q_phy - model.predict(recording.q_cmd)
    return model.shifted(error[good].mean(axis=0))


def refit_ends(recording: Recording, rows: int = REFIT_ROWS) -> int:
    """Return the first row that a refit has not used; errors after a refit are evaluated from there."""
    return int(np.flatnonzero(recording.valid)[:rows][-1]) + 1
