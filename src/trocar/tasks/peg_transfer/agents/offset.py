"""Offset between an arm's tip and its place according to the joints, learned from looks at blocks in the jaws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EXPECTED_M = 0.5e-3
"""SD of the offset before anything was seen; of twenty arms in ten sessions, two were off by 0.9 mm."""
NOISE_M = 0.45e-3
"""SD of one look: the offset changes as the wrist turns (0.2 to 0.5 mm), and the camera has errors too."""


class TipOffset:
    """Offset in the board's plane from errors of the base and the fitted joints, assumed to be the same everywhere.

    Closing jaws centre a wall between them, so a look at the block shows the jaws' offset across the wall. Along the
    wall the block does not move, and shows nothing. Walls at different angles determine both components.

    Attributes:
        xy_m: (2,) the most probable offset, in the board's axes.
    """

    def __init__(self) -> None:
        self._information = np.eye(2) / EXPECTED_M**2
        self._seen = np.zeros(2)
        self.xy_m: NDArray[np.floating] = np.zeros(2)

    def learn(self, across: NDArray[np.float64], off_m: NDArray[np.float64]) -> None:
        """Update the offset with one look.

        Args:
            across: (2,) unit vector across the wall.
            off_m: (2,) where the block was seen, less where it was expected with the present offset.
        """
        off = across @ (off_m + self.xy_m)
        self._information = self._information + np.outer(across, across) / NOISE_M**2
        self._seen = self._seen + across * off / NOISE_M**2
        self.xy_m = np.linalg.solve(self._information, self._seen)
