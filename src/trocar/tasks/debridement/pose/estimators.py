"""Estimators of a gripper's pose: the interface, kinematics alone, the last error held, and the paper's rule."""

from __future__ import annotations

from math import inf
from typing import Protocol

import numpy as np

from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry import SE3, SO3


class PoseEstimator(Protocol):
    """Estimates the pose that the camera would detect now, from past observations.

    Example:
        >>> from trocar.geometry import SE3
        >>> from trocar.tasks.debridement.pose import PaperAdjustment
        >>> estimator = PaperAdjustment()
        >>> estimator.update(0.0, SE3.identity(), SE3.from_parts(translation_m=(0.02, 0.0, 0.0)))
        >>> T_base_kinematic = SE3.from_parts(translation_m=(0.0, 0.01, 0.0))
        >>> estimator.estimate(0.1, T_base_kinematic).translation_m.tolist()
        [0.02, 0.01, 0.0]

    Attributes:
        foresees: whether ``settled`` is valid centimetres away from where the gripper was last seen, not only near it.
    """

    foresees: bool

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Update with the kinematic pose of this moment and, if the camera saw the gripper, the detected pose."""
        ...

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the pose at a time not before the last update; does not change the estimator."""
        ...

    def settled(self, T_base_kinematic: SE3) -> SE3:
        """Return the expected pose once the arm has come to rest at this kinematic pose."""
        ...


class RawKinematics:
    """Trusts the forward kinematics, as the Raven's control software does."""

    foresees = True

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Do nothing."""

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose."""
        return T_base_kinematic

    def settled(self, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose."""
        return T_base_kinematic


def check_order(t_s: float, last_s: float | None) -> None:
    """Refuse a time before the last one.

    Raises:
        InvalidInput: time runs backwards, or is not a number.
    """
    if not t_s >= (-inf if last_s is None else last_s):
        after = "" if last_s is None else f" after one at {last_s} s"
        raise InvalidInput(f"a pose at {t_s} s", f"came{after}", "give poses in the order of their times")


class HeldError:
    """Adds the last seen ``p_c - p_K`` and ``R_c R_K^-1``, both in the base frame, to the kinematics."""

    foresees = True

    def __init__(self) -> None:
        self._t_s: float | None = None
        self._last: tuple[SE3, SE3] | None = None

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Note a detection."""
        check_order(t_s, self._t_s)
        self._t_s = t_s
        if T_base_detected is not None:
            self._last = T_base_detected, T_base_kinematic

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the kinematic pose with the last error added; before any detection, the kinematic pose."""
        check_order(t_s, self._t_s)
        return self.settled(T_base_kinematic)

    def settled(self, T_base_kinematic: SE3) -> SE3:
        """Return the same, since a held error does not depend on time."""
        if self._last is None:
            return T_base_kinematic
        detected, kinematic = self._last
        R = detected.rotation @ kinematic.rotation.inverse() @ T_base_kinematic.rotation
        return SE3.from_parts(R, T_base_kinematic.translation_m + detected.translation_m - kinematic.translation_m)


STILL_M, STILL_RAD = 1e-4, 1e-3
"""An arm whose encoders moved no further since the last detection is taken to be where it was detected."""


class PaperAdjustment:
    """Extends the last detection by the kinematic increment between two adjustments (Kehoe 2014, V-A.2).

    ``dT_c = L dT_K R``, with increments ``dT = T_before^-1 T_after``. Each detection updates L or R in turn, half-way
    to what would make the increment since the detection before exact. In print the update of R inverts the detected
    increment in place of the kinematic one; ``R = (L dT_K)^-1 dT_c`` solves the paper's equation 1.

    It holds only locally, as the paper notes: a path of centimetres is rotated by the orientation error. And it is
    meant for the time between detections: ``L R`` is not the identity, so an arm at rest is taken to be where it was
    detected.

    Args:
        share: of the way to the exact adjustment, in (0, 1]; their program has 0.5.
    """

    foresees = False

    def __init__(self, share: float = 0.5) -> None:
        if not 0 < share <= 1:
            raise InvalidValue("the share of the way to the new adjustment", share, "give a number in (0, 1]")
        self.share = share
        self.T_left = self.T_right = SE3.identity()
        self._left_is_next = True
        self._t_s: float | None = None
        self._last: tuple[SE3, SE3] | None = None

    def update(self, t_s: float, T_base_kinematic: SE3, T_base_detected: SE3 | None) -> None:
        """Adjust to a detection; kinematics alone change nothing."""
        check_order(t_s, self._t_s)
        self._t_s = t_s
        if T_base_detected is None:
            return
        if self._last is not None:
            before_detected, before_kinematic = self._last
            self._adjust(before_detected.inverse() @ T_base_detected, before_kinematic.inverse() @ T_base_kinematic)
        self._last = T_base_detected, T_base_kinematic

    def estimate(self, t_s: float, T_base_kinematic: SE3) -> SE3:
        """Return the last detection extended by the adjusted increment; before any detection, the kinematic pose."""
        check_order(t_s, self._t_s)
        return self.settled(T_base_kinematic)

    def settled(self, T_base_kinematic: SE3) -> SE3:
        """Return the same, since the rule does not depend on time."""
        if self._last is None:
            return T_base_kinematic
        T_base_detected, before_kinematic = self._last
        increment = before_kinematic.inverse() @ T_base_kinematic
        if np.linalg.norm(increment.translation_m) < STILL_M and increment.rotation.angle() < STILL_RAD:
            return T_base_detected
        return T_base_detected @ self.T_left @ increment @ self.T_right

    def _adjust(self, detected: SE3, kinematic: SE3) -> None:
        if self._left_is_next:
            self.T_left = interpolate(self.T_left, detected @ (kinematic @ self.T_right).inverse(), self.share)
        else:
            self.T_right = interpolate(self.T_right, (self.T_left @ kinematic).inverse() @ detected, self.share)
        self._left_is_next = not self._left_is_next


def interpolate(T_from: SE3, T_to: SE3, share: float) -> SE3:
    """Return the interpolated pose: positions along a line, rotations about one axis (slerp)."""
    turn = (T_from.rotation.inverse() @ T_to.rotation).log()
    translation_m = (1 - share) * T_from.translation_m + share * T_to.translation_m
    return SE3.from_parts(T_from.rotation @ SO3.exp(share * turn), translation_m)
