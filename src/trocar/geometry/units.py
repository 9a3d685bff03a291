"""How lengths and angles are displayed: in millimetres and degrees."""

from __future__ import annotations

import math

_SHOWN = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg")}


def shown_scale(unit: str) -> tuple[float, str]:
    """Return the factor and the unit that show a value in ``'m'`` or ``'rad'``: mm or deg."""
    return _SHOWN[unit]


def shown(value: float, unit: str, spec: str = ".1f") -> str:
    """Return a value in ``'m'`` or ``'rad'`` as text, such as ``'12.3 mm'``.

    Args:
        value: in SI units.
        unit: ``'m'`` or ``'rad'``.
        spec: format of the number in mm or deg.
    """
    scale, name = shown_scale(unit)
    return f"{scale * value:{spec}} {name}"
