"""Arrays from users: finite numbers of the requested shape, or one sentence on what is wrong."""

from __future__ import annotations

from types import EllipsisType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput

NUMBERS = "biuf"
"""Kinds of arrays that hold real numbers."""


def finite(what: str, values: ArrayLike, *shape: int | str | EllipsisType) -> NDArray[np.float64]:
    """Return finite float64 numbers of a shape.

    >>> finite("a point", [1, 2, 3], 3).tolist()
    [1.0, 2.0, 3.0]

    Args:
        what: its name in the sentence on what is wrong.
        values: to be checked; not copied if that can be avoided.
        shape: length of each axis; a letter stands for any length, ``...`` in front for any axes.

    Raises:
        TrocarError: these are not numbers, they have another shape, or one is NaN or infinite.
    """
    array = numbers(what, values, *shape)
    last = array.shape[array.ndim - len(shape) + 1 :] if shape[:1] == (...,) else array.shape
    wanted = shape[1:] if shape[:1] == (...,) else shape
    if len(last) != len(wanted) or any(isinstance(n, int) and n != m for n, m in zip(wanted, last, strict=True)):
        raise InvalidInput(what, f"must have shape {_shown(shape)}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidInput(what, f"must be finite, got {_where(array)}", "check where it comes from")
    return array


def numbers(what: str, values: ArrayLike, *shape: int | str | EllipsisType) -> NDArray[np.float64]:
    """Return float64 numbers of any shape, finite or not; ``shape`` only tells what is wanted.

    Raises:
        TrocarError: these are not numbers.
    """
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):  # rows of different lengths
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in NUMBERS:
        raise InvalidInput(what, f"must be numbers of shape {_shown(shape)}, got {' '.join(repr(values).split()):.60}")
    return array.astype(np.float64, copy=False)


def _where(array: NDArray[np.float64]) -> str:
    """Return the first number that is not finite, and where it stands."""
    first = np.argwhere(~np.isfinite(array))[0].tolist()
    value = array[tuple(first)]
    return f"{value}" + (f" at {first}" if first else "")


def _shown(shape: tuple[int | str | EllipsisType, ...]) -> str:
    parts = ["..." if n is ... else str(n) for n in shape]
    return f"({', '.join(parts)}{',' * (len(parts) == 1 and shape != (...,))})"
