"""Cameras that read out less: binned, cropped, and pairs of windows."""

import numpy as np
import pytest

from trocar.errors import InvalidInput, InvalidValue, TrocarError
from trocar.geometry import SE3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, RgbdImage, StereoImage, StereoRig, StereoWindow, Window

BENT = (-0.1, 0.05, 1e-3, -2e-3, 0.01)
LENS = Intrinsics(12, 8, 10.0, 11.0, 5.5, 3.25, BENT)
OTHER = Intrinsics(12, 8, 20.0, 21.0, 6.5, 4.25)
RIG = StereoRig(LENS, OTHER, SE3.from_parts(translation_m=[0.05, 0.0, 0.0]))


def test_not_a_number_is_no_focal_length():
    with pytest.raises(TrocarError, match="fx of Intrinsics holds NaN"):
        Intrinsics(12, 8, np.nan, 11.0, 5.5, 3.25)


def test_a_binned_pixel_looks_where_the_middle_of_its_pixels_did():
    point = [0.05, -0.03, 0.4]
    for factor in (1, 2, 4):
        binned = LENS.binned(factor)
        assert (binned.width, binned.height) == (12 // factor, 8 // factor)
        assert isinstance(binned.width, int) and isinstance(binned.height, int)
        corner = project(LENS, point) + 0.5  # counted from the corner of the image, not from the first pixel's middle
        np.testing.assert_allclose(project(binned, point), corner / factor - 0.5)


@pytest.mark.parametrize("factor", [0, 3, 8])
def test_binning_has_to_divide_both_sides(factor):
    """Of 12 x 8 pixels: 3 divides the width alone; 8 the height."""
    with pytest.raises(InvalidInput, match=f"binning by {factor} does not divide the image of 12 x 8 pixels"):
        LENS.binned(factor)


@pytest.mark.parametrize(("corner", "size"), [((0, 0), (12, 8)), ((3, 2), (9, 6)), ((11, 7), (1, 1)), ((2, 3), (4, 3))])
def test_a_rectangle_sees_the_same_point_so_much_nearer_to_its_corner(corner, size):
    cropped = LENS.cropped(corner, size)
    assert (cropped.width, cropped.height) == size
    point = [0.05, -0.03, 0.4]
    np.testing.assert_allclose(project(cropped, point), project(LENS, point) - corner)


@pytest.mark.parametrize(
    ("corner", "size"),
    [((-1, 0), (4, 4)), ((0, -1), (4, 4)), ((0, 0), (0, 4)), ((0, 0), (4, 0)), ((9, 0), (4, 4)), ((0, 5), (4, 4))],
)
def test_a_rectangle_has_to_be_one_inside_the_image(corner, size):
    with pytest.raises(InvalidInput, match="leaves the image of 12 x 8 pixels; choose one inside"):
        LENS.cropped(corner, size)


def test_windows_of_a_pair_read_out_each_eye_by_itself():
    window = StereoWindow(Window((2, 4), (8, 4)), Window((4, 4), (6, 4)), binning=2)
    pair = window.of(RIG)
    assert pair.left == LENS.cropped((2, 4), (8, 4)).binned(2)
    assert pair.right == OTHER.cropped((4, 4), (6, 4)).binned(2)
    assert pair.T_left_right is RIG.T_left_right
    whole = Window((0, 0), (12, 8))
    assert StereoWindow(whole, whole).of(RIG) == RIG


@pytest.mark.parametrize("numbers", [(3, 4, 8, 4), (2, 3, 8, 4), (2, 4, 7, 4), (2, 4, 8, 3)])
def test_the_binning_of_a_pair_has_to_divide_every_number(numbers):
    odd, even = Window(numbers[:2], numbers[2:]), Window((2, 4), (8, 4))
    for left, right in ((odd, even), (even, odd)):
        with pytest.raises(InvalidInput, match="binning by 2 does not divide the window"):
            StereoWindow(left, right, 2)
    assert StereoWindow(odd, odd, 1).binning == 1
    with pytest.raises(InvalidInput, match="binning by 0 does not divide the window"):
        StereoWindow(even, even, 0)


def test_images_have_to_be_as_large_as_their_camera_says():
    color, depth = np.zeros((8, 12, 3), np.uint8), np.zeros((8, 12), np.float32)
    with pytest.raises(InvalidValue, match=r"depth of an RGBD image is of shape \(7, 12\); it needs \(8, 12\)"):
        RgbdImage(color, depth[1:], LENS)
    for wrong in (color[:, 1:], color[..., :2], color.astype(float)):
        with pytest.raises(InvalidValue, match=r"an RGBD image is .* its camera takes uint8 \(8, 12, 3\)"):
            RgbdImage(wrong, depth, LENS)
        with pytest.raises(InvalidValue, match="the left image of a pair"):
            StereoImage(wrong, color, RIG)
        with pytest.raises(InvalidValue, match="the right image of a pair"):
            StereoImage(color, wrong, RIG)
