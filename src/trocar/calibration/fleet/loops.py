"""Hysteresis loops of one common shape, by which instruments are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.plant import WRIST, play_slacks

MULTIPLES = np.array([0.4, 1.0, 1.8])
"""Radii of the play operators of a joint, in multiples of its backlash: real loops have round corners."""
FEATURES = 4 + 3 * len(MULTIPLES)
"""Number of inputs of the linear map to the errors of q4 q5 q6: 1, q4, q5, q6, then the slacks of each joint in
turn."""


@dataclass(frozen=True, eq=False)
class LoopShape:
    """The shape of the wrist's hysteresis loops, without the weights.

    Attributes:
        radii: (3,) backlash of roll, pitch, yaw, rad.
        a: share of yaw in the motion of the pitch cable.
        b: share of pitch in the motion of the yaw cable.
    """

    radii: NDArray[np.float64]
    a: float
    b: float

    @staticmethod
    def of(theta: NDArray[np.float64]) -> LoopShape:
        """Return the shape with these parameters (5,): logarithms of the radii, a, b."""
        return LoopShape(np.exp(theta[:3]), float(theta[3]), float(theta[4]))

    @property
    def theta(self) -> NDArray[np.float64]:
        """Return the parameters (5,)."""
        return np.array([*np.log(self.radii), self.a, self.b])

    @property
    def banks(self) -> NDArray[np.float64]:
        """Return the radii (3, k) of all operators."""
        return self.radii[:, None] * MULTIPLES

    def slacks(self, q_cmd: NDArray[np.float64], starts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slacks (n, 3, s, k) along commands (n, 6).

        Args:
            q_cmd: all commands since the arm was at rest.
            starts: (s,) slacks before the first one, as shares of the radii: -1 to 1.
        """
        shape = (3, len(starts), len(MULTIPLES))
        radii = np.broadcast_to(self.banks[:, None], shape)
        slacks = play_slacks(q_cmd, self.a, self.b, radii.reshape(3, -1), (starts[:, None] * radii).reshape(3, -1))
        return slacks.reshape(len(q_cmd), *shape)

    def features(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the features (n, FEATURES) along commands (n, 6) that start without slack."""
        slacks = self.slacks(q_cmd, np.zeros(1))
        return np.column_stack([np.ones(len(q_cmd)), q_cmd[:, WRIST], slacks.reshape(len(q_cmd), -1)])
