"""Points from two eyes, also with relative rotation and distortion."""

import cv2
import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import Intrinsics, StereoImage, StereoRig, StereoWindow, Window
from trocar.perception.stereo import is_rectified, rectify, triangulate

LENS = Intrinsics(640, 480, 800.0, 800.0, 319.5, 239.5)
PLAIN = StereoRig(LENS, LENS, SE3.from_parts(translation_m=[0.05, 0.0, 0.0]))
BENT = StereoRig(
    Intrinsics(640, 480, 800.0, 805.0, 310.0, 250.0, (-0.2, 0.05, 1e-3, -5e-4, 0.0)),
    Intrinsics(640, 480, 790.0, 795.0, 330.0, 236.0, (-0.15, 0.02, 0.0, 4e-4, 0.0)),
    SE3.from_parts(SO3.exp([0.02, -0.06, 0.03]), [0.05, 0.002, -0.003]),
)


def points(count=30):
    return np.random.default_rng(0).uniform([-0.05, -0.05, 0.25], [0.08, 0.05, 0.4], (count, 3))


def seen(rig, p):
    return project(rig.left, p), project(rig.right, rig.T_left_right.inverse().apply(p))


@pytest.mark.parametrize("rig", [PLAIN, BENT])
def test_points_are_found_again(rig):
    p = points()
    found, miss = triangulate(rig, *seen(rig, p))
    assert np.abs(found - p).max() < 1e-9
    assert miss.max() < 1e-9


def test_windows_find_the_same_points():
    window = StereoWindow(Window((100, 60), (400, 300)), Window((20, 60), (400, 300)))
    left, right = seen(PLAIN, points())
    found, _ = triangulate(window.of(PLAIN), left - [100, 60], right - [20, 60])
    assert np.abs(found - points()).max() < 1e-9
    assert is_rectified(window.of(PLAIN))


def test_binned_windows_find_the_same_points():
    window = StereoWindow(Window((100, 60), (400, 300)), Window((20, 60), (400, 300)), binning=2)
    left, right = seen(PLAIN, points())
    found, _ = triangulate(window.of(PLAIN), (left - [100.5, 60.5]) / 2, (right - [20.5, 60.5]) / 2)
    assert np.abs(found - points()).max() < 1e-9
    with pytest.raises(TrocarError, match="binning by 3 does not divide the window"):
        StereoWindow(Window((100, 60), (400, 300)), Window((20, 60), (400, 300)), binning=3)


def test_rays_that_do_not_meet_before_the_eyes_give_no_point():
    found, miss = triangulate(PLAIN, [300.0, 200.0], [400.0, 200.0])
    assert np.isnan(found).all() and np.isnan(miss)


def test_by_how_much_rays_miss_each_other():
    left, right = seen(PLAIN, np.array([0.01, 0.0, 0.3]))
    _, miss = triangulate(PLAIN, left, right + [0.0, 4.0])
    assert miss == pytest.approx(4 / 800 * 0.3, rel=0.02)


def dotted(lens, pixels):
    picture = np.zeros((lens.height, lens.width), dtype=np.float32)
    v, u = np.mgrid[: lens.height, : lens.width]
    for at in pixels:
        picture += np.exp(-0.5 * ((u - at[0]) ** 2 + (v - at[1]) ** 2) / 2.5**2).astype(np.float32)
    return np.repeat(np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)[..., None], 3, -1)


def dots(picture):
    count, labels, _, _ = cv2.connectedComponentsWithStats((picture[..., 0] > 20).astype(np.uint8))
    found = []
    for k in range(1, count):
        v, u = np.nonzero(labels == k)
        weight = picture[v, u, 0].astype(float)
        found.append([np.average(u, weights=weight), np.average(v, weights=weight)])
    return np.array(found)


def test_a_rectified_pair_sees_the_same_points_in_the_same_rows():
    grid = np.stack(np.meshgrid([-0.02, 0.02, 0.05], [-0.04, 0.0, 0.04]), -1).reshape(-1, 2)
    p = np.column_stack([grid, 0.3 + 0.01 * np.arange(9)])
    left, right = seen(BENT, p)
    image = StereoImage(dotted(BENT.left, left), dotted(BENT.right, right), BENT, 1.5)
    flat, R_left_rectified = rectify(image)
    assert is_rectified(flat.rig) and flat.time_s == 1.5
    expected = R_left_rectified.inverse().apply(p)
    for picture, lens, shift in ((flat.left, flat.rig.left, 0.0), (flat.right, flat.rig.right, 1.0)):
        at = project(lens, expected - shift * flat.rig.T_left_right.translation_m)
        found = dots(picture)
        assert np.linalg.norm(found[:, None] - at, axis=-1).min(0).max() < 0.1


def test_a_rectified_pair_stays_as_it_is():
    image = StereoImage(dotted(LENS, []), dotted(LENS, []), PLAIN)
    assert rectify(image)[0] is image


def test_what_is_no_pair_is_refused():
    picture = np.zeros((480, 640, 3), dtype=np.uint8)
    with pytest.raises(TrocarError, match="left eye of 640 x 480 pixels needs a picture"):
        rectify(StereoImage(picture[:100], picture, PLAIN))
    ahead = StereoRig(LENS, LENS, SE3.from_parts(translation_m=[0.0, 0.0, 0.05]))
    with pytest.raises(TrocarError, match="side by side"):
        rectify(StereoImage(picture, picture, ahead))
    with pytest.raises(TrocarError, match="leaves the image"):
        StereoWindow(Window((600, 0), (100, 100)), Window((0, 0), (100, 100))).of(PLAIN)
