"""The simplest correction: the last error seen still holds."""

from __future__ import annotations

from trocar.geometry import SE3
from trocar.tasks.debridement.pose.estimator import check_order


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
