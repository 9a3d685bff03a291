"""Directions: vectors of any length."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput


def direction(vector: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return a vector (3,) of any length, however small or large, as a unit vector.

    >>> direction([3e307, 4e307, 0.0], "the upward direction").round(3).tolist()
    [0.6, 0.8, 0.0]

    Args:
        vector: three numbers.
        what: its name in the error message.

    Raises:
        TrocarError: they are not three, not finite, or all zero.
    """
    try:
        given = np.asarray(vector, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        raise InvalidInput(what, f"is {vector}", "give three finite numbers that are not all 0, such as 0 0 1")
    scaled = given / np.abs(given).max()  # squares of the largest and smallest floats overflow or underflow
    return scaled / np.linalg.norm(scaled)
