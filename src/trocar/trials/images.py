"""Camera images as a trial keeps them: small, and good enough to see what the camera saw."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.perception.image import RgbdImage
from trocar.sim.laboratory import SimCamera

QUALITY = 70
"""Of WebP, of 100."""
EFFORT = 1
"""Of WebP, of 6: a third of the time of 4, the usual one, for a file that is a fifth larger."""
THINNED = 4
"""Depth is kept at one in this many pixels, in whole millimetres."""
PACKED = 3
"""Of PNG, of 9, which takes seven times as long for a file that is one in a hundred smaller."""


def encoded(cameras: Mapping[str, SimCamera]) -> tuple[dict[str, bytes], dict[str, list[tuple[float, str]]]]:
    """Return the images that cameras took as files by name; and for each camera the times and names of its images.

    Colour is WebP. Depth is a 16-bit PNG in mm, 0 where there was none, beside it under ``NAME_depth.png``.
    """
    blobs: dict[str, bytes] = {}
    taken: dict[str, list[tuple[float, str]]] = {}
    for name, camera in cameras.items():
        taken[name] = []
        for number, image in enumerate(camera.taken):
            stem = f"{name}_{number:03d}"
            color = image.color if isinstance(image, RgbdImage) else np.hstack([image.left, image.right])
            blobs[f"{stem}.webp"] = _webp(color)
            if isinstance(image, RgbdImage):
                depth_mm = np.rint(1e3 * np.nan_to_num(image.depth_m[::THINNED, ::THINNED])).astype(np.uint16)
                packed = cv2.imencode(".png", np.ascontiguousarray(depth_mm), [cv2.IMWRITE_PNG_COMPRESSION, PACKED])[1]
                blobs[f"{stem}_depth.png"] = packed.tobytes()
            taken[name].append((round(image.time_s, 6), f"{stem}.webp"))
    return blobs, taken


def _webp(color: NDArray[np.uint8]) -> bytes:
    """Return a picture (h, w, 3) as a file; OpenCV would not let us choose the effort."""
    file = BytesIO()
    Image.fromarray(color).save(file, "webp", quality=QUALITY, method=EFFORT)
    return file.getvalue()
