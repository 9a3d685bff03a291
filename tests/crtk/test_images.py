"""Images as ROS cameras publish them, read."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.images import binned, color_of, cut_out, depth_of
from trocar.crtk.messages import Image
from trocar.errors import InvalidInput
from trocar.perception.image import Intrinsics, RgbdImage, Window

COLORS = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)


def message(pixels, encoding, pad=0, big=0):
    height = pixels.shape[0]
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, pad)))
    return Image(
        height=height,
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=big,
        step=rows.shape[1],
        data=rows.tobytes(),
    )


@pytest.mark.parametrize("pad", [0, 7])
def test_colours_are_read_in_every_order_and_rows_may_be_longer(pad):
    alpha = np.full((4, 5, 1), 9, np.uint8)
    assert np.array_equal(color_of(message(COLORS, "rgb8", pad)), COLORS)
    assert np.array_equal(color_of(message(COLORS[..., ::-1], "bgr8", pad)), COLORS)
    assert np.array_equal(color_of(message(np.concatenate([COLORS, alpha], 2), "rgba8", pad)), COLORS)
    assert np.array_equal(color_of(message(np.concatenate([COLORS[..., ::-1], alpha], 2), "bgra8", pad)), COLORS)


@pytest.mark.parametrize("big", [0, 1])
def test_depth_is_in_metres_and_nan_where_there_is_none(big):
    order = ">" if big else "<"
    depth_m = np.array([[0.5, np.nan], [0.25, 1.0]], np.float32)
    depth_mm = np.array([[500, 0], [250, 1000]], np.uint16)
    assert np.array_equal(depth_of(message(depth_m.astype(f"{order}f4"), "32FC1", 0, big)), depth_m, equal_nan=True)
    assert depth_of(message(depth_mm.astype(f"{order}u2"), "16UC1", 0, big)) == pytest.approx(depth_m, nan_ok=True)


def test_what_cannot_be_read_is_refused_with_what_can():
    with pytest.raises(InvalidInput, match="encoding 'yuv422'; publish one of rgb8, bgr8"):
        color_of(message(COLORS, "yuv422"))
    with pytest.raises(InvalidInput, match="depth of encoding 'rgb8'"):
        depth_of(message(COLORS, "rgb8"))
    short = message(COLORS, "rgb8")
    short.data = short.data[:-1]
    with pytest.raises(InvalidInput, match="has 59 bytes, rows of 15, for 5 x 4 pixels"):
        color_of(short)


def test_a_window_is_the_camera_that_reads_out_only_it():
    lens = Intrinsics(5, 4, 10.0, 10.0, 2.0, 1.5)
    depth = np.arange(20, dtype=np.float32).reshape(4, 5)
    part = cut_out(RgbdImage(COLORS, depth, lens, 3.0), Window((1, 2), (3, 2)))
    assert np.array_equal(part.color, COLORS[2:4, 1:4]) and np.array_equal(part.depth_m, depth[2:4, 1:4])
    assert (part.intrinsics.cx, part.intrinsics.cy, part.time_s) == (1.0, -0.5, 3.0)


def test_binned_pixels_are_means():
    assert np.array_equal(binned(np.array([[[0], [2]], [[4], [6]]], np.uint8).repeat(3, 2), 2), [[[3, 3, 3]]])
