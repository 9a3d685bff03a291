"""How far an arm's tip is from where its joints have it, as looks at what its jaws hold show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EXPECTED_M = 0.5e-3
"""Offsets before anything was seen; of twenty arms in ten sessions, two were off by .9."""
NOISE_M = 0.45e-3
"""What one look may be off by: the offset changes as the wrist turns (.2 to .5), and the camera errs."""


class TipOffset:
    """An offset in the board's plane, taken to be the same everywhere: of the base, and of joints fitted wrongly.

    Jaws that close centre a wall between them, so a look at the block tells how far they are off across the wall.
    Along it the block stays where it was, and tells nothing. Walls at different angles tell both.

    Attributes:
        xy_m: (2,) the most probable offset, in the board's axes.
    """

    def __init__(self) -> None:
        self._information = np.eye(2) / EXPECTED_M**2
        self._seen = np.zeros(2)
        self.xy_m: NDArray[np.floating] = np.zeros(2)

    def learn(self, across: NDArray[np.float64], off_m: NDArray[np.float64]) -> None:
        """Take a look into account.

        Args:
            across: (2,) unit vector across the wall.
            off_m: (2,) where the block was seen, less where it was expected with the present offset.
        """
        off = across @ (off_m + self.xy_m)
        self._information = self._information + np.outer(across, across) / NOISE_M**2
        self._seen = self._seen + across * off / NOISE_M**2
        self.xy_m = np.linalg.solve(self._information, self._seen)
