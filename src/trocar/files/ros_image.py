"""The pixels of images as ROS has them (``sensor_msgs/Image``), of ROS 1 and ROS 2 alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

RGB, BGR, ONE = slice(0, 3), slice(2, None, -1), 0
ENCODINGS: dict[str, tuple[str, int, slice | int]] = {
    **{"rgb8": ("u1", 3, RGB), "bgr8": ("u1", 3, BGR), "8UC3": ("u1", 3, BGR)},
    **{"rgba8": ("u1", 4, RGB), "bgra8": ("u1", 4, BGR), "mono8": ("u1", 1, ONE), "8UC1": ("u1", 1, ONE)},
    **{"mono16": ("u2", 1, ONE), "16UC1": ("u2", 1, ONE), "32FC1": ("f4", 1, ONE)},
}
"""Type and number of a pixel's channels, and which of them are red, green and blue; 8UC3 is OpenCV's blue, green, red.
Depth is 16UC1, in mm, or 32FC1, in m."""


class Damaged(Exception):
    """The bytes of a message are no image, or not one of the size that it claims."""


def pixels(message: Any) -> NDArray[Any]:
    """Return colours (height, width, 3) RGB, or grey or depth (height, width), of one of the ``ENCODINGS``.

    Rows may be padded, and bytes swapped.

    Raises:
        Damaged: the message has no pixels, or more or fewer than it claims.
    """
    kind, channels, order = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * channels * dtype.itemsize
    if not used or not message.height or message.step < used or len(message.data) != message.step * message.height:
        size = f"{message.width} x {message.height} pixels"
        raise Damaged(f"has {len(message.data)} bytes, rows of {message.step}, for {size}")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)[:, :used]
    values = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, channels)
    return values[..., order].astype(kind, order="C")
