"""Camera images as stored with a trial: small, but good enough to show what the camera saw."""

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
"""WebP quality, out of 100."""
EFFORT = 1
"""WebP effort, out of 6; the default, 4, takes three times as long for a file that is a sixth smaller."""
THINNED = 4
"""Depth is stored for one in this many rows and columns, in whole millimetres."""
PACKED = 3
"""PNG compression, out of 9; level 9 takes seven times as long for a file that is one percent smaller."""


def encoded(cameras: Mapping[str, SimCamera]) -> tuple[dict[str, bytes], dict[str, list[tuple[float, str]]]]:
    """Return the cameras' images as files by name, and for each camera the times and names of its images.

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
