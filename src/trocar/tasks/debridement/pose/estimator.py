"""The interface of estimators of a gripper's pose, and the estimator that does nothing."""

from __future__ import annotations

from math import inf
from typing import Protocol

from trocar.errors import TrocarError
from trocar.geometry import SE3


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
        TrocarError: time runs backwards, or is not a number.
    """
    if not t_s >= (-inf if last_s is None else last_s):
        after = "" if last_s is None else f" after one at {last_s} s"
        raise TrocarError(f"a pose at {t_s} s came{after}; give poses in the order of their times")
