"""The usual way to differentiate measured positions, for comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from trocar.motion.analysis.huber import Motion

SAMPLES, ORDER = 21, 3
"""Width of the window and degree of the polynomials: .2 s at 100 Hz."""


def savitzky_golay(measured: NDArray[np.float64], step_s: float, samples: int = SAMPLES, order: int = ORDER) -> Motion:
    """Return the motion that polynomials through a sliding window give (Savitzky and Golay 1964).

    Args:
        measured: (n,) finite, at even steps.
        step_s: between samples.
        samples: in a window, odd.
        order: of the polynomials.
    """
    found = (np.asarray(savgol_filter(measured, samples, order, deriv=k, delta=step_s)) for k in range(3))
    return Motion(*found)
