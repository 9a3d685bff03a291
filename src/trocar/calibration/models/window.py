"""Windows of the last few commands, the memory of some models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PRIOR_COMMANDS = 5
"""Number of prior commands in a window, in addition to the present one (paper, section IV-A)."""


def windows(q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each sample's window, oldest first, (n, 6) -> (n, 1 + 5, 6); the arm is at rest before the first."""
    rows = np.arange(len(q_cmd))[:, None] + np.arange(-PRIOR_COMMANDS, 1)
    return q_cmd[np.maximum(rows, 0)]


def resting_window(q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the prior commands (5, 6) of an arm that has been at rest at this command (6,)."""
    return np.repeat(q_cmd[None], PRIOR_COMMANDS, axis=0)


def advance(prior: NDArray[np.float64], q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the window (6, 6) of a command (6,) that follows its prior commands (5, 6)."""
    return np.concatenate([prior, q_cmd[None]])
