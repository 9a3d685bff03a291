"""Checks of arrays that users give, unit vectors, and the display of lengths and angles."""

from __future__ import annotations

import math
from types import EllipsisType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput

Array = NDArray[np.float64]
TURN = 2 * math.pi  # one whole turn, in rad
NUMBERS = "biuf"  # kinds of arrays that hold real numbers


def finite(what: str, values: ArrayLike, *shape: int | str | EllipsisType) -> Array:
    """Return values as a finite float64 array of a given shape.

    >>> finite("a point", [1, 2, 3], 3).tolist()
    [1.0, 2.0, 3.0]

    Args:
        what: name of the values in the error message.
        values: to be checked; not copied if that can be avoided.
        shape: length of each axis; a string stands for any length, a leading ``...`` for any number of axes.

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


def numbers(what: str, values: ArrayLike, *shape: int | str | EllipsisType) -> Array:
    """Return a float64 array, finite or not (TrocarError: not numbers). ``shape`` is only for the message."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):  # rows of different lengths
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in NUMBERS:
        raise InvalidInput(what, f"must be numbers of shape {_shown(shape)}, got {' '.join(repr(values).split()):.60}")
    return array.astype(np.float64, copy=False)


def _where(array: Array) -> str:
    """Return the first number that is not finite, and where it stands."""
    first = np.argwhere(~np.isfinite(array))[0].tolist()
    value = array[tuple(first)]
    return f"{value}" + (f" at {first}" if first else "")


def _shown(shape: tuple[int | str | EllipsisType, ...]) -> str:
    parts = ["..." if n is ... else str(n) for n in shape]
    return f"({', '.join(parts)}{',' * (len(parts) == 1 and shape != (...,))})"


def appended(values: Array, last: float) -> Array:
    """Return values (n,) and one more, (n + 1,); ten times as fast as ``np.append``."""
    longer = np.empty(len(values) + 1)
    longer[:-1], longer[-1] = values, last
    return longer


def direction(vector: ArrayLike, what: str) -> Array:
    """Return a vector (3,) of any length, however small or large, as a unit vector.

    >>> direction([3e307, 4e307, 0.0], "the upward direction").round(3).tolist()
    [0.6, 0.8, 0.0]

    Raises TrocarError, which calls the vector ``what``: it is zero, or not three finite numbers.
    """
    try:
        given = np.asarray(vector, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        raise InvalidInput(what, f"is {vector}", "give three finite numbers that are not all 0, such as 0 0 1")
    scaled = given / np.abs(given).max()  # squares of the largest and smallest floats overflow or underflow
    return scaled / np.linalg.norm(scaled)


def shown_scale(unit: str) -> tuple[float, str]:
    """Return the factor and the unit that show a value in ``'m'`` or ``'rad'``: mm or deg."""
    return {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg")}[unit]


def shown(value: float, unit: str, spec: str = ".1f") -> str:
    """Return a value in ``'m'`` or ``'rad'`` as text in mm or deg, such as ``'12.3 mm'``."""
    scale, name = shown_scale(unit)
    return f"{scale * value:{spec}} {name}"
