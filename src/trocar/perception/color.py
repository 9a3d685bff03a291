"""Colour segmentation: red printed ABS on a black table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RED_SHARE = 0.5
"""Minimum share of red in R + G + B; photographed blocks have .57-.72, steel and table .33, yellow tape .45."""

DARK = 24
"""Minimum red (of 255) at which the hue is reliable; in the photographs shadows have 36-52, the table below 24."""


def red_mask(color: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels (...) of an RGB image (..., 3) are red to orange and not dark."""
    r, g, b = (color[..., k].astype(np.float32) for k in range(3))
    return (r >= DARK) & (r > RED_SHARE * (r + g + b)) & (r > 1.5 * g) & (g >= 0.6 * b)
