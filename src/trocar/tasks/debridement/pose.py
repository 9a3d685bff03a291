"""Estimators of a gripper's true pose, from kinematics and occasional detections (Kehoe 2014, V-A.2)."""

from __future__ import annotations

from contextlib import suppress
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from trocar.arms import ArmModel, fk, ik_near
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3


class PoseEstimator(Protocol):
    """Estimates the pose that the camera would detect, from past detections.

    Example:
        >>> from trocar.geometry import SE3
        >>> from trocar.tasks.debridement.pose import PaperAdjustment
        >>> estimator = PaperAdjustment()
        >>> estimator.learn(SE3.identity(), SE3.from_parts(translation_m=(0.02, 0.0, 0.0)))
        >>> T_base_kinematic = SE3.from_parts(translation_m=(0.0, 0.01, 0.0))
        >>> estimator.estimate(T_base_kinematic).translation_m.tolist()
        [0.02, 0.01, 0.0]

    Attributes:
        foresees: whether estimates are valid centimetres away from where the gripper was last seen, not only near it.
    """

    foresees: bool

    def learn(self, T_base_kinematic: SE3, T_base_detected: SE3) -> None:
        """Learn from the detected and the kinematic pose of one moment; call it in order of time."""
        ...

    def estimate(self, T_base_kinematic: SE3) -> SE3:
        """Return the pose expected at this kinematic pose; before any detection, the kinematic pose itself."""
        ...


STILL_M, STILL_RAD = 1e-4, 1e-3
"""An arm whose encoders moved no further since the last detection is taken to be where it was detected."""
SHARE = 0.5  # each detection adjusts by this share of the way to the exact adjustment, as in the authors' program


class PaperAdjustment:
    """Extends the last detection by the kinematic increment between two adjustments (Kehoe 2014, V-A.2).

    ``dT_c = L dT_K R``, with increments ``dT = T_before^-1 T_after``. Detections update L and R in turn, half-way to
    the value that makes the increment since the previous detection exact. The paper prints an update of R that inverts
    the detected increment instead of the kinematic one; ``R = (L dT_K)^-1 dT_c`` solves its equation 1.

    The adjustment holds only locally, as the paper notes: a path of centimetres is rotated by the orientation error.
    ``L R`` is not the identity, so an arm at rest is taken to be where it was last detected.
    """

    foresees = False

    def __init__(self) -> None:
        self.T_left = self.T_right = SE3.identity()
        self._left_is_next = True
        self._last: tuple[SE3, SE3] | None = None

    def learn(self, T_base_kinematic: SE3, T_base_detected: SE3) -> None:
        """Adjust L or R to a detection."""
        if self._last is not None:
            before_detected, before_kinematic = self._last
            detected = before_detected.inverse() @ T_base_detected
            kinematic = before_kinematic.inverse() @ T_base_kinematic
            if self._left_is_next:
                self.T_left = interpolate(self.T_left, detected @ (kinematic @ self.T_right).inverse())
            else:
                self.T_right = interpolate(self.T_right, (self.T_left @ kinematic).inverse() @ detected)
            self._left_is_next = not self._left_is_next
        self._last = T_base_detected, T_base_kinematic

    def estimate(self, T_base_kinematic: SE3) -> SE3:
        """Return the last detection extended by the adjusted increment."""
        if self._last is None:
            return T_base_kinematic
        T_base_detected, before_kinematic = self._last
        increment = before_kinematic.inverse() @ T_base_kinematic
        if np.linalg.norm(increment.translation_m) < STILL_M and increment.rotation.angle() < STILL_RAD:
            return T_base_detected
        return T_base_detected @ self.T_left @ increment @ self.T_right


def interpolate(T_from: SE3, T_to: SE3, share: float = SHARE) -> SE3:
    """Return the interpolated pose: positions along a line, rotations about one axis (slerp)."""
    turn = (T_from.rotation.inverse() @ T_to.rotation).log()
    translation_m = (1 - share) * T_from.translation_m + share * T_to.translation_m
    return SE3.from_parts(T_from.rotation @ SO3.exp(share * turn), translation_m)


FIELD_SD = np.array([0.04, 0.04, 0.007, 0.1, 0.1, 0.1])
"""SD of the part of a joint's error that changes with position, rad and m: 7 mm at 17 cm, the error of the recorded
Raven after a rigid fit (`data/raven/gripper_pose_pairs.csv`)."""
CONSTANT, HYSTERESIS, NOISE = 3.0, 0.12, 0.08
"""SD of the other parts as shares of ``FIELD_SD``: the constant (38 mm and 24.5 deg in the recording), the part that
depends on the path, and a detection's noise (0.5 mm, 0.5 deg: see the stereo benchmark)."""
LENGTH = np.array([0.30, 0.30, 0.07, 1.0, 1.0, 1.0])
"""Length scales of the field in the joints, rad and m: 5 to 7 cm for the outer joints (assumed)."""
FORGETS = 0.5  # travel, in these lengths, over which the path-dependent part changes
APART, MOST = 0.2, 250
"""Spacing along the path (in lengths) of the detections that are kept, and how many of the newest are kept: about as
many as one arm collects with six fragments."""
GATE = float(chi2.ppf(0.999, 6))  # squared Mahalanobis distance that one in a thousand good detections exceeds
SLIPPED = 5  # after this many surprises in a row a cable has slipped, and everything learned before is forgotten


class ErrorField:
    """Estimates the joints' errors by a Gaussian process over the joints, so it remembers the errors at a place.

    Encoders at the motors do not see what the cables do between motor and joint. This depends on the positions of the
    joints, a little on the path to them, and not on time. All six errors share one kernel: constant, field, hysteresis.
    The more surprising a detection is, the less it counts.
    """

    foresees = True

    def __init__(self, arm: ArmModel) -> None:
        self._arm = arm
        self._places, self._ways = np.zeros((0, 6)), np.zeros(0)
        self._errors, self._noises = np.zeros((0, 6)), np.zeros(0)
        self._way = 0.0
        self._last: NDArray[np.float64] | None = None
        self._factor: tuple[NDArray[np.float64], bool] | None = None
        self._weights = np.zeros((0, 6))
        self._surprises = 0

    def learn(self, T_base_kinematic: SE3, T_base_detected: SE3) -> None:
        """Add the errors of the joints at this place, unless no joints of this arm have the detected pose."""
        q = ik_near(self._arm, T_base_kinematic, self._arm.middle)
        place = q / LENGTH
        if self._last is not None:
            self._way += float(np.linalg.norm(place - self._last))
        self._last = place
        with suppress(OutOfReach):
            self._learn(place, (ik_near(self._arm, T_base_detected, q) - q) / FIELD_SD)

    def estimate(self, T_base_kinematic: SE3) -> SE3:
        """Return the pose with the joints' estimated errors corrected.

        Raises:
            OutOfReach: no joints have this kinematic pose.
        """
        if self._factor is None or self._last is None:
            return T_base_kinematic
        q = ik_near(self._arm, T_base_kinematic, self._arm.middle)
        place = q / LENGTH
        way = self._way + float(np.linalg.norm(place - self._last))
        return fk(self._arm, q + FIELD_SD * (self._alike(place, way) @ self._weights))

    def _learn(self, place: NDArray[np.float64], error: NDArray[np.float64]) -> None:
        """Add errors (6,), in units of ``FIELD_SD``, at a place (6,), in lengths."""
        noise = NOISE**2
        if self._factor is not None:
            alike = self._alike(place, self._way)
            unsure = CONSTANT**2 + 1 + HYSTERESIS**2 - float(alike @ cho_solve(self._factor, alike)) + noise
            surprise = error - alike @ self._weights
            beyond = max(1.0, float(surprise @ surprise) / unsure / GATE)
            noise *= beyond
            self._surprises = self._surprises + 1 if beyond > 1 else 0
        kept = slice(-MOST + 1, None)
        if self._surprises == SLIPPED:
            kept, noise, self._surprises = slice(0, 0), NOISE**2, 0
        elif len(self._ways) > 1 and self._ways[-1] - self._ways[-2] < APART:
            kept = slice(-MOST, -1)
        self._places, self._ways = np.vstack([self._places[kept], place]), np.append(self._ways[kept], self._way)
        self._errors, self._noises = np.vstack([self._errors[kept], error]), np.append(self._noises[kept], noise)
        covariance = _kernel(self._places, self._ways, self._places, self._ways) + np.diag(self._noises)
        self._factor = cho_factor(covariance, lower=True)
        self._weights = cho_solve(self._factor, self._errors)

    def _alike(self, place: NDArray[np.float64], way: float) -> NDArray[np.float64]:
        """Return the covariances (n,) of the errors at a place with those that were seen."""
        return _kernel(place[None], np.array([way]), self._places, self._ways)[0]


def _kernel(
    places: NDArray[np.float64], ways: NDArray[np.float64], others: NDArray[np.float64], other_ways: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariances (n, m) of the errors at places (n, 6) and (m, 6), with path positions (n,) and (m,)."""
    squares = ((places[:, None] - others[None]) ** 2).sum(axis=-1)
    forgotten = np.exp(-np.abs(ways[:, None] - other_ways[None]) / FORGETS)
    return CONSTANT**2 + np.exp(-0.5 * squares) + HYSTERESIS**2 * forgotten
