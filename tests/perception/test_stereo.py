"""Points from two eyes, also with relative rotation and distortion."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project, rays_through
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


def test_a_point_is_the_middle_of_the_shortest_line_between_its_rays():
    left, right = seen(BENT, points())
    left, right = left + [3.0, -5.0], right + [-2.0, 4.0]
    found, miss = triangulate(BENT, left, right)
    one = rays_through(BENT.left, left)
    other = BENT.T_left_right.rotation.apply(rays_through(BENT.right, right))
    shift = BENT.T_left_right.translation_m
    for k in range(len(found)):
        along, *_ = np.linalg.lstsq(np.column_stack([one[k], -other[k]]), shift)
        near, far = along[0] * one[k], shift + along[1] * other[k]
        np.testing.assert_allclose(found[k], (near + far) / 2, atol=1e-12)
        assert miss[k] == pytest.approx(np.linalg.norm(near - far), abs=1e-12)


def test_binned_windows_find_the_same_points():
    window = StereoWindow(Window((100, 60), (400, 300)), Window((20, 60), (400, 300)), binning=2)
    left, right = seen(PLAIN, points())
    found, _ = triangulate(window.of(PLAIN), (left - [100.5, 60.5]) / 2, (right - [20.5, 60.5]) / 2)
    assert np.abs(found - points()).max() < 1e-9
    assert is_rectified(window.of(PLAIN))


def through(T_left_right, p):
    """Return triangulate's answer for the lines through a point and both eyes, also where it lies behind an eye."""
    at = [q[:2] / q[2] * 800.0 + [319.5, 239.5] for q in (p, T_left_right.inverse().apply(p))]
    return triangulate(StereoRig(LENS, LENS, T_left_right), *at)


def test_rays_that_do_not_meet_before_the_eyes_give_no_point():
    found, miss = triangulate(PLAIN, [300.0, 200.0], [400.0, 200.0])
    assert np.isnan(found).all() and np.isnan(miss)


@pytest.mark.parametrize("ahead_m", [0.2, -0.2])
def test_rays_that_meet_behind_one_of_the_eyes_give_no_point(ahead_m):
    """The right eye stands before the left one, or behind it."""
    T = SE3.from_parts(translation_m=[0.05, 0.0, ahead_m])
    for z_m in (0.05, 0.3):
        p = np.array([0.02, 0.01, z_m + min(ahead_m, 0.0)])
        found, miss = through(T, p)
        before_both = min(p[2], p[2] - ahead_m) > 0.0
        assert np.isfinite(miss) == before_both
        np.testing.assert_allclose(found, p if before_both else np.full(3, np.nan), atol=1e-12)


def test_parallel_rays_give_no_point():
    """Far away is nowhere: not a warning, either."""
    found, miss = triangulate(PLAIN, [[300.0, 200.0], [319.5, 239.5]], [[300.0, 200.0], [319.5, 239.5]])
    assert np.isnan(found).all() and np.isnan(miss).all()


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


def bent(**changed):
    return replace(LENS, **changed)


@pytest.mark.parametrize(
    ("left", "right", "shift_m", "turn"),
    [
        (bent(distortion=(0.0, 0.0, 0.0, 0.0, 0.1)), LENS, (0.05, 0.0, 0.0), 0.0),
        (LENS, bent(distortion=(0.1, 0.0, 0.0, 0.0, 0.0)), (0.05, 0.0, 0.0), 0.0),
        (LENS, LENS, (0.05, 0.0, 0.0), 1e-6),
        (LENS, LENS, (0.05, 1e-6, 0.0), 0.0),
        (LENS, LENS, (0.05, 0.0, -1e-6), 0.0),
        (LENS, LENS, (-0.05, 0.0, 0.0), 0.0),
        (LENS, LENS, (0.0, 0.0, 0.0), 0.0),
        (LENS, bent(fx=801.0), (0.05, 0.0, 0.0), 0.0),
        (LENS, bent(fy=801.0), (0.05, 0.0, 0.0), 0.0),
        (LENS, bent(cy=240.0), (0.05, 0.0, 0.0), 0.0),
        (LENS, bent(height=470), (0.05, 0.0, 0.0), 0.0),
    ],
)
def test_a_pair_is_rectified_only_if_rows_are_common_and_depth_shifts_to_the_left(left, right, shift_m, turn):
    rig = StereoRig(left, right, SE3.from_parts(SO3.axis("z", turn), shift_m))
    assert not is_rectified(rig)
    assert is_rectified(PLAIN)


def test_eyes_of_a_rectified_pair_may_be_as_wide_as_they_like():
    assert is_rectified(StereoRig(LENS, bent(width=600, cx=280.0), PLAIN.T_left_right))
    near = SE3.from_parts(translation_m=[1e-4, 0.0, 0.0])
    assert is_rectified(StereoRig(LENS, LENS, near))


def black(rig):
    """Return small images of a pair."""
    return StereoImage(*(np.zeros((lens.height, lens.width, 3), np.uint8) for lens in (rig.left, rig.right)), rig)


TINY = Intrinsics(64, 48, 80.0, 82.0, 30.0, 26.0)


@pytest.mark.parametrize("axis", "xy")
def test_the_new_eyes_look_where_both_did_on_average(axis):
    """Across the line between the eyes: turned as far from the left one's axis as from the right one's."""
    T = SE3.from_parts(SO3.axis(axis, 0.1), [0.05 * np.cos(0.05), 0.0, -0.05 * np.sin(0.05) * (axis == "y")])
    flat, R = rectify(black(StereoRig(TINY, TINY, T)))
    ahead = R.matrix[:, 2]
    assert np.arccos(ahead @ [0.0, 0.0, 1.0]) == pytest.approx(0.05, abs=1e-9)
    assert np.arccos(ahead @ T.rotation.matrix[:, 2]) == pytest.approx(0.05, abs=1e-9)
    assert ahead @ T.translation_m == pytest.approx(0.0, abs=1e-12)
    shift = flat.rig.T_left_right.translation_m
    np.testing.assert_allclose(R.apply(shift), T.translation_m, atol=1e-12)


@pytest.mark.parametrize("smallest", range(4))
def test_the_new_focal_length_is_the_smallest_so_that_no_pixel_has_to_be_made_up(smallest):
    f = np.where(np.arange(4) == smallest, 70.0, 90.0)
    rig = StereoRig(replace(TINY, fx=f[0], fy=f[1]), replace(TINY, fx=f[2], fy=f[3]), BENT.T_left_right)
    new = rectify(black(rig))[0].rig
    assert (new.left.fx, new.left.fy, new.right.fx, new.right.fy) == (70.0,) * 4


def test_the_middle_of_each_picture_stays_its_middle():
    """Across; up and down it is the middle of both, as rows are common."""
    other = replace(TINY, width=60, height=52, cx=31.5, cy=24.0)
    rig = StereoRig(TINY, other, BENT.T_left_right)
    flat, R = rectify(black(rig))
    high = []
    for old, new, turn in (
        (rig.left, flat.rig.left, R),
        (rig.right, flat.rig.right, rig.T_left_right.rotation.inverse() @ R),
    ):
        assert (new.width, new.height) == (old.width, 52)
        u, v = project(new, turn.inverse().apply(rays_through(old, [(old.width - 1) / 2, (old.height - 1) / 2])))
        assert u == pytest.approx((old.width - 1) / 2)
        high.append(v - (old.height - 1) / 2)
    assert np.mean(high) == pytest.approx(0.0, abs=1e-9)
    assert flat.left.shape == (52, 64, 3) and flat.right.shape == (52, 60, 3)


@pytest.mark.parametrize(("sine", "refused"), [(0.0, True), (0.04, True), (0.07, False)])
def test_eyes_almost_behind_each_other_are_refused(sine, refused):
    rig = StereoRig(TINY, TINY, SE3.from_parts(translation_m=[0.05 * sine, 0.0, 0.05 * np.sqrt(1 - sine**2)]))
    if refused:
        with pytest.raises(TrocarError, match="side by side"):
            rectify(black(rig))
    else:
        assert is_rectified(rectify(black(rig))[0].rig)
