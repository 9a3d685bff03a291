"""The filter's memory of the kinematic poses: where they began, and how they moved recently."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3


@dataclass(frozen=True, eq=False)
class KinematicHistory:
    """Kinematic poses up to now.

    Attributes:
        T_base_first: where they began; gains act on the change since then, to be independent of the constant.
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
