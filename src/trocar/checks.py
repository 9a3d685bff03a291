"""Checks for values that users construct."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from trocar.errors import TrocarError


def require_numbers(value: Any) -> None:
    """Raise if a number in a dataclass's own fields, or in a tuple among them, is NaN; for ``__post_init__``.

    Raises:
        TrocarError: one is NaN; the sentence names the class and the field.
    """
    for field in fields(value):
        held = getattr(value, field.name)
        parts = held if isinstance(held, tuple) else (held,)
        for part in parts:
            if isinstance(part, float | np.ndarray) and np.asarray(part).dtype.kind in "fc" and np.isnan(part).any():
                raise TrocarError(f"{field.name} of {type(value).__name__} holds NaN ({held}); give a number")
