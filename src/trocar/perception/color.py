"""Segmentation by colour: by the share of red, or by hue, saturation, value in OpenCV's units (to 179, 255, 255)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

HUES = 180
RED_SHARE = 0.5
"""Minimum share of red in R + G + B; photographed blocks have .57-.72, steel and table .33, yellow tape .45."""

DARK = 24
"""Minimum red (of 255) at which the hue is reliable; in the photographs shadows have 36-52, the table below 24."""


def red_mask(color: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels (...) of an RGB image (..., 3) are red to orange and not dark."""
    r, g, b = (color[..., k].astype(np.float32) for k in range(3))
    return (r >= DARK) & (r > RED_SHARE * (r + g + b)) & (r > 1.5 * g) & (g >= 0.6 * b)


@dataclass(frozen=True)
class HueRange:
    """A range of colours."""

    low: int  # first hue; if above ``high``, the range goes through 0
    high: int  # last hue
    saturation: int  # smallest
    value: int  # smallest, because hue means nothing in the dark

    @staticmethod
    def around(rgb: tuple[float, float, float], hue: int = 9, saturation: int = 110, value: int = 35) -> HueRange:
        """Return the hues that differ by at most ``hue`` from that of a colour in [0, 1]."""
        paint = np.array([[rgb]], dtype=np.float32)
        middle = round(float(cv2.cvtColor(paint, cv2.COLOR_RGB2HSV)[0, 0, 0]) / 2)
        return HueRange((middle - hue) % HUES, (middle + hue) % HUES, saturation, value)

    def mask(self, hsv: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return 255 for each pixel (h, w) of an HSV picture (h, w, 3) in the range, else 0."""
        if self.low <= self.high:
            return self._between(hsv, self.low, self.high)
        return self._between(hsv, self.low, HUES - 1) | self._between(hsv, 0, self.high)

    def _between(self, hsv: NDArray[np.uint8], low: int, high: int) -> NDArray[np.uint8]:
        found = cv2.inRange(hsv, np.array([low, self.saturation, self.value]), np.array([high, 255, 255]))
        return np.asarray(found, dtype=np.uint8)


RED_FOAM = HueRange(170, 6, 120, 50)
"""Colour of the fragments: hue 0-6 or 170-180, as in the program of Kehoe et al. 2014."""


def to_hsv(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an RGB picture (h, w, 3) as HSV."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2HSV), dtype=np.uint8)
