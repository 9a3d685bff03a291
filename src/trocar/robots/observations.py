"""What a camera saw of an arm's instrument, combined into a recording on which its cables can be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.arms.solids import joint_axes
from trocar.calibration.recording import Recording
from trocar.perception.instrument import Sighting

SHIFT_SD_M = 0.5e-3
"""SD of an instrument's shift on each axis, due to its registered base and the errors of its outer joints."""
WORST_M = 0.6e-3
"""A sighting whose points lie further than this (SD) from the instrument's solids shows something else."""
LEAST_INFORMATION = 1.0
"""1/rad^2, added to the information: a rotation about which an image shows nothing has an SD of one radian."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One sighting, and when it was.

    Attributes:
        row: index of the last command that had been sent.
        sighting: fitted with the outer joints where they were commanded.
    """

    row: int
    sighting: Sighting


@dataclass(frozen=True, eq=False)
class Combined:
    """A recording made of observations of the instrument.

    Attributes:
        recording: all commands; measured where there was an observation.
        sd_rad: (n, 3) of the wrist's measurements.
        shift_m: (3,) shift of the instrument from where the commanded outer joints put it, in the arm's base.
    """

    recording: Recording
    sd_rad: NDArray[np.float64]
    shift_m: NDArray[np.float64]


def combine(arm: ArmModel, name: str, q_cmd: NDArray[np.float64], observations: Sequence[Observation]) -> Combined:
    """Return the recording made of observations.

    The shift of the instrument is common to all observations and is found from all of them; then each of them gives its
    wrist joints.

    Args:
        arm: whose instrument was seen.
        name: of the recording.
        q_cmd: (n, 6) all commands that were sent, including where they reversed; rad and m.
        observations: in order.
    """
    good = [observation for observation in observations if observation.sighting.left_m < WORST_M]
    shift_m = _common_shift(good)
    measured, sd = np.full_like(q_cmd, np.nan), np.ones((len(q_cmd), 3))
    for observation in good:
        measured[observation.row], covariance = joints_seen(arm, observation.sighting, shift_m)
        sd[observation.row] = np.sqrt(np.diag(covariance))
    times = np.arange(len(q_cmd), dtype=np.float64)
    valid: NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(axis=1))
    recording = Recording(q_cmd, measured, valid, times, name)
    return Combined(recording, sd, shift_m)


def _common_shift(observations: Sequence[Observation]) -> NDArray[np.float64]:
    """Return the most likely shift (3,) given all observations, whatever the wrist joints were in each."""
    information, pull = np.eye(3) / SHIFT_SD_M**2, np.zeros(3)
    for observation in observations:
        seen = observation.sighting
        across = seen.information[3:, :3] @ _of_wrist(seen)
        known = seen.information[3:, 3:] - across @ seen.information[:3, 3:]
        information += known
        pull += known @ seen.shift_m + seen.pull[3:] - across @ seen.pull[:3]
    return np.asarray(np.linalg.solve(information, pull), dtype=np.float64)


def joints_seen(
    arm: ArmModel, seen: Sighting, shift_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the joints (6,) in a sighting for this shift of the instrument, and the wrist's covariance (3, 3)."""
    covariance, q = _of_wrist(seen), seen.q.copy()
    q[3:] += covariance @ (seen.pull[:3] - seen.information[:3, 3:] @ (shift_m - seen.shift_m))
    axes, origins = joint_axes(arm, q)
    by_outer = np.column_stack([*np.cross(axes[:2], origins[5] - origins[:2]), axes[2]])
    q[:3] += np.linalg.solve(by_outer, shift_m)
    return q, covariance


def _of_wrist(seen: Sighting) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of the wrist in a sighting, given the shift."""
    return np.asarray(np.linalg.inv(seen.information[:3, :3] + LEAST_INFORMATION * np.eye(3)), dtype=np.float64)
