"""Checks for values that users construct."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from trocar.errors import InvalidInput


def require_numbers(value: Any) -> None:
    """Raise if a dataclass's field, or an item of a tuple in it, is NaN; for ``__post_init__``.

    Raises:
        TrocarError: one is NaN; the message names the class and the field.
    """
    for field in fields(value):
        held = getattr(value, field.name)
        if _has_nan(held):
            raise InvalidInput(field.name, f"of {type(value).__name__} holds NaN ({held})", "give a number")


def decimals(value: float, bound: float) -> int:
    """Return the number of decimals, four or more, with which two different values read differently."""
    return next((n for n in range(4, 17) if float(f"{value:.{n}f}") != float(f"{bound:.{n}f}")), 17)


def small(size: float) -> str:
    """Return a size as text with enough decimals, four or more, to read as more than nothing."""
    return f"{size:.{decimals(size, 0.0)}f}"


def outside(value: float, lower: float, upper: float) -> tuple[str, str]:
    """Return a value and the range that it leaves, as texts with enough decimals to tell it from the range's end."""
    n = decimals(value, lower if value < lower else upper)
    return f"{value:.{n}f}", f"[{lower:.{n}f}, {upper:.{n}f}]"


def takes(function: Callable[..., Any], count: int) -> bool:
    """Return whether a function can be called with this many values in order; also true if Python cannot tell."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # some functions that are written in C
        return True
    try:
        signature.bind(*range(count))
    except TypeError:
        return False
    return True


def _has_nan(held: Any) -> bool:
    if isinstance(held, tuple):
        return any(map(_has_nan, held))
    return isinstance(held, float | np.ndarray) and np.asarray(held).dtype.kind in "fc" and bool(np.isnan(held).any())
