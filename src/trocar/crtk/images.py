"""Images as ROS cameras publish them: make and read messages, and cut out windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.messages import CameraInfo, Header, Image
from trocar.errors import InvalidInput
from trocar.files.ros_image import ENCODINGS, Damaged, pixels
from trocar.perception.image import CameraModel, Intrinsics, RgbdImage, StereoImage, StereoRig, StereoWindow, Window
from trocar.perception.image import Image as Taken

COLORS = [encoding for encoding, (kind, *_) in ENCODINGS.items() if kind == "u1"]


def parts_of(model: CameraModel) -> tuple[str, str]:
    """Return the topics, below a camera's namespace, of both parts of its images; the first has the lens."""
    return ("left", "right") if isinstance(model, StereoRig) else ("color", "depth")


def lens_of(model: CameraModel) -> Intrinsics:
    """Return the lens of the first part of a camera's images."""
    return model.left if isinstance(model, StereoRig) else model


def color_message(color: NDArray[np.uint8], header: Header) -> Image:
    """Return the message of colours (height, width, 3) RGB."""
    height, width, channels = color.shape
    return Image(header, height, width, "rgb8", 0, channels * width, color.tobytes())


def depth_message(depth_m: NDArray[np.float32], header: Header) -> Image:
    """Return the message of depth (height, width) in m, NaN where there is none."""
    height, width = depth_m.shape
    return Image(header, height, width, "32FC1", 0, 4 * width, depth_m.astype("<f4").tobytes())


def info_message(model: CameraModel, part: str, header: Header) -> CameraInfo:
    """Return the message of a lens.

    Args:
        model: one lens, or the two of a rectified pair.
        part: of an image: ``right`` is a pair's right lens, whose projection is shifted by the baseline.
        header: of the message.
    """
    lens, shift_m = lens_of(model), 0.0
    if isinstance(model, StereoRig) and part == "right":
        lens, shift_m = model.right, float(model.T_left_right.translation_m[0])
    projection = np.column_stack([lens.matrix, [-lens.fx * shift_m, 0.0, 0.0]])
    return CameraInfo(
        header=header,
        height=lens.height,
        width=lens.width,
        distortion_model="plumb_bob",
        d=list(lens.distortion),
        k=lens.matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def color_of(message: Image, item: str = "an image") -> NDArray[np.uint8]:
    """Return the colours (height, width, 3) RGB of a message.

    Raises:
        InvalidInput: their encoding is not supported.
    """
    if message.encoding not in COLORS:
        raise InvalidInput(item, f"is of encoding {message.encoding!r}", f"publish one of {', '.join(COLORS)}")
    color = _pixels(message, item)
    return color if color.ndim == 3 else np.stack([color] * 3, axis=-1)


def depth_of(message: Image, item: str = "an image") -> NDArray[np.float32]:
    """Return the depth (height, width) in m of a message, NaN where there is none.

    Raises:
        InvalidInput: its encoding is not supported.
    """
    if message.encoding not in ("32FC1", "16UC1"):
        problem = f"has depth of encoding {message.encoding!r}"
        raise InvalidInput(item, problem, "publish 32FC1 (m, NaN for none) or 16UC1 (mm, 0 for none)")
    depth = _pixels(message, item)
    return depth if message.encoding == "32FC1" else np.where(depth == 0, np.float32(np.nan), np.float32(1e-3) * depth)


def _pixels(message: Image, item: str) -> NDArray:
    try:
        return pixels(message)
    except Damaged as error:
        raise InvalidInput(item, str(error), "correct its publisher") from None


def cut_out(image: Taken, window: Window | StereoWindow) -> Taken:
    """Return the part of an image that a window reads out, its pixels combined if the window says so."""
    if isinstance(image, StereoImage) and isinstance(window, StereoWindow):
        left, right = (
            binned(eye[_slices(part)], window.binning)
            for eye, part in ((image.left, window.left), (image.right, window.right))
        )
        return StereoImage(left, right, window.of(image.rig), image.time_s)
    assert isinstance(image, RgbdImage) and isinstance(window, Window)
    here = _slices(window)
    model = image.intrinsics.cropped(window.corner_px, window.size_px)
    return RgbdImage(image.color[here].copy(), image.depth_m[here].copy(), model, image.time_s)


def _slices(window: Window) -> tuple[slice, slice]:
    (u, v), (width, height) = window.corner_px, window.size_px
    return slice(v, v + height), slice(u, u + width)


def binned(color: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Return colours whose pixels are the means of ``factor`` x ``factor`` pixels."""
    height, width = color.shape[0] // factor, color.shape[1] // factor
    blocks = color.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    return np.rint(blocks).astype(np.uint8)
