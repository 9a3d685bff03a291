"""An estimator of a gripper's pose that filters the error of its kinematics and learns the systematic part as it runs.

It needs recorded poses only, no joints. docs/debridement.md explains it; bench_gripper_pose.py measures it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import chi2

from trocar.geometry import SE3, SO3


@dataclass(frozen=True, eq=False)
class KinematicHistory:
    """Kinematic poses up to now.

    Attributes:
        T_base_first: the first pose; gains act on the change since then, which separates them from the constant.
        T_base_last: the last pose.
        t_s: its time.
        lag: (6,) translation in m and rotation vector in rad, both in the base frame, from the last pose to one that
            follows the poses with a first-order lag.
        lag_s: time constant of that lag.
    """

    T_base_first: SE3
    T_base_last: SE3
    t_s: float
    lag: NDArray[np.float64]
    lag_s: float

    @staticmethod
    def begin(t_s: float, T_base_kinematic: SE3, lag_s: float) -> KinematicHistory:
        """Return the history of a first pose, assumed to be at rest."""
        return KinematicHistory(T_base_kinematic, T_base_kinematic, t_s, np.zeros(6), lag_s)

    def then(self, t_s: float, T_base_kinematic: SE3) -> KinematicHistory:
        """Return the history after one more pose, reached at constant velocity."""
        dt_s = t_s - self.t_s
        if dt_s <= 0:
            return self if dt_s < 0 else replace(self, T_base_last=T_base_kinematic)
        kept = np.exp(-dt_s / self.lag_s)
        velocity = _change(self.T_base_last, T_base_kinematic) / dt_s
        lag = kept * self.lag - (1 - kept) * self.lag_s * velocity
        return replace(self, T_base_last=T_base_kinematic, t_s=t_s, lag=lag)

    def translation_design(self) -> NDArray[np.float64]:
        """Return (3, 19): constant, drift, lag, offset in the tool frame (3), gain matrix on the position (9)."""
        first, last = self.T_base_first, self.T_base_last
        tool = last.rotation.matrix - first.rotation.matrix
        position = np.kron(last.translation_m - first.translation_m, np.eye(3))
        return np.hstack([np.eye(3), np.eye(3), self.lag[:3, None], tool, position], dtype=np.float64)

    def rotation_design(self) -> NDArray[np.float64]:
        """Return (3, 16): constant, drift, lag, gain matrix on the rotation vector (9)."""
        turn = _change(self.T_base_first, self.T_base_last)[3:]
        return np.hstack([np.eye(3), np.eye(3), self.lag[3:, None], np.kron(turn, np.eye(3))], dtype=np.float64)


def _change(T_from: SE3, T_to: SE3) -> NDArray[np.float64]:
    """Return translation and rotation vector (6,) in the base frame."""
    turn = (T_to.rotation @ T_from.rotation.inverse()).log()
    return np.concatenate([T_to.translation_m - T_from.translation_m, turn])


GATE = float(chi2.ppf(0.999, 3))
"""Squared Mahalanobis distance that one in a thousand good observations (3,) exceeds."""
NOISE_PASSES = 2
"""Fixed-point iterations between state and noise; a third changes the noise by less than a percent."""
DRIFT = slice(3, 6)
"""Indices of the drift in the state: after the constant (3,), before the gains."""


@dataclass(frozen=True, eq=False)
class ErrorEstimate:
    """The estimate of ``error = H x + noise`` with state x = (constant, drift, gains).

    The drift is an Ornstein-Uhlenbeck process, the rest is constant. The noise is normal with an unknown covariance
    (inverse Wishart), learned beside the state by variational Bayes (Sarkka and Nummenmaa 2009).

    Attributes:
        mean: (n,) of the state.
        covariance: (n, n).
        scatter: (3, 3) weighted sum of squared residuals so far, the prior's included.
        count: how many observations the scatter stands for.
        drift_sd: of each axis of the drift, in the unit of the error.
        drift_s: time in which the drift decays by 63 %.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    scatter: NDArray[np.float64]
    count: float
    drift_sd: float
    drift_s: float

    @staticmethod
    def prior(
        constant_sd: float, gain_sds: list[float], noise: tuple[float, float], drift: tuple[float, float]
    ) -> ErrorEstimate:
        """Return the belief before any observation.

        Args:
            constant_sd: of each axis of the constant.
            gain_sds: of each gain.
            noise: standard deviation per axis, and the number of observations that this guess is worth.
            drift: ``drift_sd`` and ``drift_s``.
        """
        sds = np.array([constant_sd] * 3 + [drift[0]] * 3 + gain_sds)
        return ErrorEstimate(
            np.zeros(len(sds)), np.diag(sds**2), noise[1] * noise[0] ** 2 * np.eye(3), noise[1], *drift
        )

    @property
    def noise(self) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of the noise."""
        return self.scatter / self.count

    def after(self, dt_s: float, wandered_sd: float = 0.0) -> ErrorEstimate:
        """Return the belief a time ``dt_s`` later, after an additional wander of the drift on each axis."""
        kept = np.exp(-dt_s / self.drift_s)
        decay = np.ones(len(self.mean))
        decay[DRIFT] = kept
        covariance = decay[:, None] * self.covariance * decay
        covariance[DRIFT, DRIFT] += (self.drift_sd**2 * (1 - kept**2) + wandered_sd**2) * np.eye(3)
        return replace(self, mean=decay * self.mean, covariance=covariance)

    def observed(self, H: NDArray[np.float64], error: NDArray[np.float64], weight: float = 1.0) -> ErrorEstimate:
        """Return the belief after an observation.

        An observation beyond the gate loses weight with its squared distance: a gross outlier hardly counts, but an
        error that really jumped is followed eventually, which a hard gate might never allow.

        Args:
            H: (3, n).
            error: (3,) as observed.
            weight: in (0, 1], as a share of an independent observation.
        """
        surprise = error - H @ self.mean
        spread = H @ self.covariance @ H.T
        distance2 = surprise @ np.linalg.solve(spread + self.noise / weight, surprise)
        weight *= float(GATE / max(distance2, GATE))
        count, noise = self.count + weight, self.noise
        mean, covariance, scatter = self.mean, self.covariance, self.scatter
        for _ in range(NOISE_PASSES):
            gain = np.linalg.solve(spread + noise / weight, H @ self.covariance).T
            mean, covariance = self.mean + gain @ surprise, self.covariance - gain @ H @ self.covariance
            residual = error - H @ mean
            scatter = self.scatter + weight * (np.outer(residual, residual) + H @ covariance @ H.T)
            noise = scatter / count
        covariance = (covariance + covariance.T) / 2
        return replace(self, mean=mean, covariance=covariance, scatter=scatter, count=count)


WAY_M = 0.010
"""Distance travelled by the gripper to which ``FilterSettings.way_m`` and ``way_rad`` refer."""


@dataclass(frozen=True)
class FilterSettings:
    """Assumptions before any detection; standard deviations are per axis.

    Constants, tool offset and tilt describe an arm that was never calibrated; drift and noise are only first guesses,
    and docs/debridement.md says how little each setting matters.

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

    def __init__(self, settings: FilterSettings | None = None) -> None:
        s = self.settings = settings or FilterSettings()
        gains = [s.lag_gain] + [s.tool_m] * 3 + [s.tilt] * 9
        self._translation = ErrorEstimate.prior(s.constant_m, gains, (s.noise_m, s.noise_count), (s.drift_m, s.drift_s))
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
        history, translation, rotation = self._at(t_s, T_base_kinematic)
        H_p, H_r = history.translation_design(), history.rotation_design()
        R = SO3.exp(H_r @ rotation.mean) @ (self._R_first_error or SO3.identity()) @ T_base_kinematic.rotation
        T_base_gripper = SE3.from_parts(R, T_base_kinematic.translation_m + H_p @ translation.mean)
        covariance = block_diag(H_p @ translation.covariance @ H_p.T, H_r @ rotation.covariance @ H_r.T)
        return PoseEstimate(T_base_gripper, covariance, block_diag(translation.noise, rotation.noise))

    def _at(self, t_s: float, T_base_kinematic: SE3) -> tuple[KinematicHistory, ErrorEstimate, ErrorEstimate]:
        """Return history and beliefs at a moment, before any detection of that moment."""
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
