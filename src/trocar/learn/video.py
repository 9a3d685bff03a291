"""Images of cameras as videos: each image is shown until the next one was taken."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import InvalidInput
from trocar.files.output import replacing
from trocar.files.video import mp4
from trocar.learn.statistics import QUANTILES

OPTIONS = {"preset": "ultrafast", "crf": "23", "g": "30"}
"""Images stand still for a second; smaller files would cost three times the work."""
THINNED = 8
"""Statistics use one in this many rows and columns."""


def write_video(
    path: str | Path, taken: Sequence[tuple[float, bytes]], frames: int, fps: int, size: tuple[int, int]
) -> dict[str, Any]:
    """Write the images of a camera as an MP4 file, and return statistics of its colours, 0 to 1, as LeRobot has them.

    The video is black before the first image. One image is in memory at a time.

    Args:
        path: of the file.
        taken: the time from which each image is shown, in s, and its file, in order.
        frames: number of frames.
        fps: frames per second.
        size: (height, width) in pixels.
    """
    shown = np.searchsorted([at_s for at_s, _ in taken], np.arange(frames) / fps + 1e-9, side="right") - 1
    sums, last = _Sums(), None
    with replacing(path) as draft, mp4(draft, size, fps, OPTIONS) as add:
        for image in shown.tolist():
            if image == last:
                add(None)
                continue
            pixels = np.zeros((*size, 3), np.uint8) if image < 0 else opened(taken[image][1], size)
            add(pixels)
            sums.add(pixels[::THINNED, ::THINNED].reshape(-1, 3), int((shown == image).sum()))
            last = image
    return sums.statistics(frames)


def opened(image: bytes, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Return the pixels (h, w, 3) of an image, cropped to even sides, which H.264 needs.

    Raises:
        InvalidInput: the image is not of this ``size``.
    """
    with Image.open(BytesIO(image)) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    height, width = (side - side % 2 for side in pixels.shape[:2])
    if size is not None and (height, width) != size:
        problem = f"has {width} x {height} pixels, and those before it {size[1]} x {size[0]}"
        raise InvalidInput("an image of a camera", problem, "export runs of different cameras separately")
    return pixels[:height, :width]


class _Sums:
    """Statistics of colours (n, 3), each image weighted by the number of frames that show it."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, 256))

    def add(self, colours: NDArray[np.uint8], weight: int) -> None:
        for channel in range(3):
            self._counts[channel] += weight * np.bincount(colours[:, channel], minlength=256)

    def statistics(self, frames: int) -> dict[str, Any]:
        levels, total = np.arange(256) / 255.0, self._counts.sum(axis=1)
        share = np.cumsum(self._counts, axis=1) / total[:, None]
        mean = self._counts @ levels / total
        seen = self._counts > 0
        found = {
            "min": levels[seen.argmax(axis=1)],
            "max": levels[255 - seen[:, ::-1].argmax(axis=1)],
            "mean": mean,
            "std": np.sqrt(np.maximum(0.0, self._counts @ levels**2 / total - mean**2)),
            **{name: levels[(share >= q).argmax(axis=1)] for name, q in QUANTILES.items()},
        }
        return {**{name: value.reshape(3, 1, 1).tolist() for name, value in found.items()}, "count": [frames]}
