"""An estimator that filters the error of the kinematics and learns its systematic part on the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.pose.error_belief import ErrorEstimate
from trocar.tasks.debridement.pose.estimator import check_order
from trocar.tasks.debridement.pose.kinematic_history import KinematicHistory

WAY_M = 0.010
"""Distance travelled by the gripper to which ``FilterSettings.way_m`` and ``way_rad`` refer."""


@dataclass(frozen=True)
class FilterSettings:
    """Assumptions before any detection; standard deviations are per axis.

    Constants, tool offset and tilt describe an arm that was never calibrated; drift and noise are only first guesses,
    and ``docs/debridement.md`` says how little each setting matters.

    Attributes:
        constant_m: constant error; 38 mm over the recording (``facts/debridement.md``), so about 22 mm per axis.
        constant_rad: likewise; 24.5 deg over the recording.
        drift_m: wandering error; after a rigid fit 7.1 mm RMS remain, or 6 mm without the camera's 3.7 mm.
        drift_rad: likewise for the rotation.
        drift_s: decay time of the drift.
        way_m: wander of the drift while the gripper moves 10 mm (a random walk along its path).
        way_rad: likewise for the rotation.
        lag_s: time constant of the lag with which the detected pose follows the kinematic one.
        lag_gain: SD of its size, as a share of a full lag.
        tool_m: offset in the gripper's frame: marks and controlled point lie within the jaws' 20 mm.
        tilt: change of the error per change of position: bases are not precision mounted.
        turn_gain: change of the rotation's error per change of rotation. At 1 the kinematics may be entirely wrong.
        noise_m: of a detection, a first guess; the covariance is learned.
        noise_rad: likewise.
        noise_count: number of detections that these guesses are worth.
        frame_s: frame time of the camera, 10 Hz (V-A.2). Detections in quicker succession show the same image and share
            a weight.
    """

    constant_m: float = 0.03
    constant_rad: float = 0.3
    drift_m: float = 0.0035
    drift_rad: float = 0.05
    drift_s: float = 10.0
    way_m: float = 0.003
    way_rad: float = 0.03
    lag_s: float = 1.0
    lag_gain: float = 1.0
    tool_m: float = 0.02
    tilt: float = 0.1
    turn_gain: float = 1.0
    noise_m: float = 0.003
    noise_rad: float = 0.03
    noise_count: float = 4.0
    frame_s: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < np.inf:
                raise TrocarError(f"filter setting {name} is {value}; give a finite number above 0")


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """An estimated pose with its uncertainty; covariances of (translation m, rotation vector rad) in the base frame.

    Attributes:
        T_base_gripper: the estimate.
        covariance: (6, 6) of ``(p_true - p, log(R_true R^-1))``.
        detection_noise: (6, 6) what a camera's detection adds to that.
    """

    T_base_gripper: SE3
    covariance: NDArray[np.float64]
    detection_noise: NDArray[np.float64]


class ErrorFilter:
    """Estimates ``p_c - p_K`` and ``R_c R_K^-1`` by two linear Kalman filters, and adds them to the kinematics.

    Each error is a constant, a drift, a share of a first-order lag, a part that is linear in the pose, and noise
    (:class:`KinematicHistory` has the equations). Rotations are vectors in the tangent space at the first detection's
    error, so that a large constant error does no harm. It is causal: it uses only the past.
    """

    foresees = True

    def __init__(self, settings: FilterSettings | None = None) -> None:
        s = self.settings = settings or FilterSettings()
        self._translation = ErrorEstimate.prior(
            s.constant_m,
            [s.lag_gain] + [s.tool_m] * 3 + [s.tilt] * 9,
            (s.noise_m, s.noise_count),
            (s.drift_m, s.drift_s),
        )
        self._rotation = ErrorEstimate.prior(
            s.constant_rad, [s.lag_gain] + [s.turn_gain] * 9, (s.noise_rad, s.noise_count), (s.drift_rad, s.drift_s)
        )
        self._history: KinematicHistory | None = None
        self._R_first_error: SO3 | None = None
        self._detected_s: float | None = None

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Follow the kinematics, and learn from a detection."""
        history, translation, rotation = self._at(t_s, T_base_kinematic)
        if T_base_detected is not None:
            error = T_base_detected.rotation @ T_base_kinematic.rotation.inverse()
            if self._R_first_error is None:
                self._R_first_error = error
            weight = self._weight(t_s)
            shift_m = T_base_detected.translation_m - T_base_kinematic.translation_m
            translation = translation.observed(history.translation_design(), shift_m, weight)
            turn = (error @ self._R_first_error.inverse()).log()
            rotation = rotation.observed(history.rotation_design(), turn, weight)
            self._detected_s = t_s
        self._history, self._translation, self._rotation = history, translation, rotation

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose with its estimated error corrected."""
        return self.belief(t_s, T_base_kinematic).T_base_gripper

    def belief(self, t_s: float, T_base_kinematic: SE3) -> PoseEstimate:
        """Return the estimate with its covariance."""
        return self._belief(T_base_kinematic, *self._at(t_s, T_base_kinematic))

    def settled(self, T_base_kinematic: SE3) -> SE3:
        """Return the pose after the lag has decayed, with the drift as estimated now."""
        if self._history is None:
            return T_base_kinematic
        resting = replace(self._history, T_base_last=T_base_kinematic, lag=np.zeros(6))
        return self._belief(T_base_kinematic, resting, self._translation, self._rotation).T_base_gripper

    def _belief(
        self, T_base_kinematic: SE3, history: KinematicHistory, translation: ErrorEstimate, rotation: ErrorEstimate
    ) -> PoseEstimate:
        H_p, H_r = history.translation_design(), history.rotation_design()
        R = SO3.exp(H_r @ rotation.mean) @ (self._R_first_error or SO3.identity()) @ T_base_kinematic.rotation
        T_base_gripper = SE3.from_parts(R, T_base_kinematic.translation_m + H_p @ translation.mean)
        covariance = _blocks(H_p @ translation.covariance @ H_p.T, H_r @ rotation.covariance @ H_r.T)
        return PoseEstimate(T_base_gripper, covariance, _blocks(translation.noise, rotation.noise))

    def _at(self, t_s: float, T_base_kinematic: SE3) -> tuple[KinematicHistory, ErrorEstimate, ErrorEstimate]:
        """Return history and beliefs at a moment, before any detection of that moment."""
        check_order(t_s, self._history and self._history.t_s)
        if self._history is None:
            return KinematicHistory.begin(t_s, T_base_kinematic, self.settings.lag_s), self._translation, self._rotation
        dt_s, s = t_s - self._history.t_s, self.settings
        way_m = np.linalg.norm(T_base_kinematic.translation_m - self._history.T_base_last.translation_m)
        steps = np.sqrt(way_m / WAY_M)
        return (
            self._history.then(t_s, T_base_kinematic),
            self._translation.after(dt_s, s.way_m * steps),
            self._rotation.after(dt_s, s.way_rad * steps),
        )

    def _weight(self, t_s: float) -> float:
        """Return the weight of a detection at this moment as a share of an independent observation, in (0, 1]."""
        if self._detected_s is None:
            return 1.0
        return min(1.0, max((t_s - self._detected_s) / self.settings.frame_s, 1e-3))


def _blocks(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the block-diagonal matrix (6, 6) of two (3, 3)."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[3:, 3:] = first, second
    return matrix
