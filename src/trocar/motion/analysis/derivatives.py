"""Derivatives of sampled signals: Savitzky-Golay and finite differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from trocar.arms import ArmModel, fk, jacobian
from trocar.errors import InvalidInput
from trocar.motion.analysis.huber import Motion, estimate

SAMPLES, ORDER = 21, 3
"""Width of the window and degree of the polynomials: .2 s at 100 Hz."""


def savitzky_golay(measured: NDArray[np.float64], step_s: float, samples: int = SAMPLES, order: int = ORDER) -> Motion:
    """Return the motion that polynomials through a sliding window give (Savitzky and Golay 1964).

    Args:
        measured: (n,) finite, at even steps.
        step_s: between samples.
        samples: in a window, odd.
        order: of the polynomials.
    """
    found = (np.asarray(savgol_filter(measured, samples, order, deriv=k, delta=step_s)) for k in range(3))
    return Motion(*found)


Array = NDArray[np.float64]

HALF_STEP_S = 1e-4
"""Half step of the central difference that gives the Jacobian's change along a motion."""


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Several signals that were measured together, with their derivatives.

    Attributes:
        position: (n, k) as estimated, in the signals' units.
        velocity: (n, k) per second.
        acceleration: (n, k) per second squared.
        step_s: between samples.
    """

    position: Array
    velocity: Array
    acceleration: Array
    step_s: float

    @property
    def jerk(self) -> Array:
        """Return the jerk (n - 1, k) between samples: the difference of accelerations over the step."""
        return np.diff(self.acceleration, axis=0) / self.step_s

    def rms(self) -> dict[str, Array]:
        """Return the root mean square (k,) of velocity, acceleration and jerk over the whole recording."""
        kinds = {"velocity": self.velocity, "acceleration": self.acceleration, "jerk": self.jerk}
        return {name: np.sqrt(np.mean(rows**2, axis=0)) for name, rows in kinds.items()}

    def largest(self) -> dict[str, Array]:
        """Return the largest magnitude (k,) of velocity, acceleration and jerk."""
        kinds = {"velocity": self.velocity, "acceleration": self.acceleration, "jerk": self.jerk}
        return {name: np.abs(rows).max(axis=0) for name, rows in kinds.items()}


@dataclass(frozen=True, eq=False)
class JointAnalysis:
    """An arm's motion.

    Attributes:
        joints: of the six joints, rad and m.
        tip: of the tool tip in the arm's base frame, m.
    """

    joints: Derivatives
    tip: Derivatives

    @property
    def path_m(self) -> float:
        """Return the length of the tip's path."""
        return float(np.linalg.norm(np.diff(self.tip.position, axis=0), axis=1).sum())


def analyse(measured: Array, step_s: float, smoothness: float | None = None) -> Derivatives:
    """Return the derivatives of signals (n, k), each estimated separately; NaN where a measurement is missing.

    Args:
        measured: positions at even steps.
        step_s: between samples.
        smoothness: weight of smoothness; None: by cross-validation, for each signal.
    """
    if measured.ndim != 2:
        raise InvalidInput("signals", f"have shape {measured.shape}", "give (samples, signals)")
    motions = [estimate(column, step_s, smoothness) for column in measured.T]
    return Derivatives(
        np.column_stack([m.position for m in motions]),
        np.column_stack([m.velocity for m in motions]),
        np.column_stack([m.acceleration for m in motions]),
        step_s,
    )


def analyse_joints(arm: ArmModel, measured: Array, step_s: float, smoothness: float | None = None) -> JointAnalysis:
    """Return the motion of an arm's joints and of its tip, from measured joints (n, 6) in rad and m.

    The tip's velocity and acceleration follow from the joints': ``J q'`` and ``J q'' + J' q'``.
    """
    joints = analyse(measured, step_s, smoothness)
    q, dq, ddq = joints.position, joints.velocity, joints.acceleration
    J = jacobian(arm, q)[:, :3]
    ahead, behind = (jacobian(arm, q + side * HALF_STEP_S * dq)[:, :3] for side in (1.0, -1.0))
    change = (ahead - behind) / (2.0 * HALF_STEP_S)
    tip = Derivatives(
        fk(arm, q).translation_m,
        np.einsum("nij,nj->ni", J, dq),
        np.einsum("nij,nj->ni", J, ddq) + np.einsum("nij,nj->ni", change, dq),
        step_s,
    )
    return JointAnalysis(joints, tip)
