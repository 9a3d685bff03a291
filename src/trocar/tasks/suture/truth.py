"""What the referee of sutures saw: simulator truth, only for the score. No agent may import this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3


@dataclass(frozen=True, eq=False)
class NeedleTruth:
    """Where the needle and the arm that drives it really were.

    Attributes:
        times_s: (n,) trial clock.
        T_circle_needle: (n,) poses in the circle's frame.
        T_circle_tip: (n,) poses of the arm's true tip in the circle's frame.
        gripped: (n,) whether both fingers of the arm press on the needle.
        in_hand: (n,) whether a person holds it.
        p_needle_tip_m: (3,) the needle's tip in its own frame.
    """

    times_s: NDArray[np.float64]
    T_circle_needle: SE3
    T_circle_tip: SE3
    gripped: NDArray[np.bool_]
    in_hand: NDArray[np.bool_]
    p_needle_tip_m: NDArray[np.float64]

    @property
    def p_circle_needle_tip_m(self) -> NDArray[np.float64]:
        """Return the needle's tip (n, 3) in the circle's frame."""
        return self.T_circle_needle.apply(self.p_needle_tip_m)
