"""A needle in made-up depth images, from where it is expected; how far evidence is from a pose."""

from itertools import pairwise

import numpy as np
import pytest

import made_up_needle
from made_up_needle import ARC, HALF_LENS, T_CAMERA_FLOOR, first_met, over_floor
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.suture import perception
from trocar.tasks.suture.perception import (
    POINT_SD_M,
    RAY_SD_PX,
    ROBUST,
    TOGETHER,
    NeedleEvidence,
    contradicting_share,
    depth_residuals,
    floor_height_m,
    normal_equations,
    ray_cost,
    ray_distances,
    search_starts,
    sight_needle,
)

SD = np.repeat([0.6e-3, 0.06], 3)


def picture(T_camera_needle, rng, depth_sd_m=0.15e-3):
    return made_up_needle.picture(T_camera_needle, rng, depth_sd_m, HALF_LENS)


def looked(images, expected, elsewhere=None):
    return sight_needle(images, expected, np.diag(SD**2), ARC, T_CAMERA_FLOOR, elsewhere)


def test_a_needle_is_found_from_where_it_is_expected_and_it_is_said_how_surely():
    rng = np.random.default_rng(0)
    before, after, scores = [], [], []
    for _ in range(8):
        true = over_floor(rng)
        off = SD * rng.standard_normal(6)
        expected = true @ SE3.exp(off)
        found = looked([picture(true, rng), picture(true, rng)], expected)
        assert found is not None and found.depth_sd_m < 0.4e-3
        error = (true.inverse() @ found.T_camera_needle).log()
        before.append(off)
        after.append(error)
        scores.append(error @ (found.information + np.diag(SD**-2.0)) @ error / 6.0)
    rms = np.sqrt(np.mean(np.square(after), axis=0))
    assert (rms[:3] < 0.2e-3).all(), "it was expected .6 mm off"
    assert (rms[3:5] < 0.03).all(), "and .06 rad; its turn about its centre is seen by its ends alone"
    assert 0.05 < np.mean(scores) < 3.0


def test_the_floor_tells_how_far_it_is_from_where_it_is_said_to_be():
    rng = np.random.default_rng(4)
    needle = over_floor(rng)
    images = [picture(needle, rng, 0.3e-3)]
    for off_m in (-0.2e-3, 0.0, 0.3e-3):
        supposed = T_CAMERA_FLOOR @ SE3.from_parts(translation_m=[0.0, 0.0, -off_m])
        assert floor_height_m(images, needle, ARC, supposed) == pytest.approx(off_m, abs=0.03e-3)
    nowhere = T_CAMERA_FLOOR @ SE3.from_parts(translation_m=[0.0, 0.0, 0.01])
    assert floor_height_m(images, needle, ARC, nowhere) is None


FAR_OFF = (-1.37e-3, -0.05e-3, -2.01e-3, 0.0853, -0.1411, -0.0716)
"""A twist of a needle that a person loaded and an arm brought (1.5 to 2 SD of both): one search ends beside it."""
UNSURE_SD = np.array([1.0e-3, 0.8e-3, 1.1e-3, 0.092, 0.083, 0.083])


def test_a_needle_far_from_where_it_is_expected_is_found_if_that_is_said_to_be_unsure():
    rng = np.random.default_rng(3)
    turn = SO3.axis("z", 0.35) @ SO3.axis("x", np.pi / 2) @ SO3.axis("z", 0.07)
    true, tip = T_CAMERA_FLOOR @ SE3.from_parts(turn, [0.0, 0.0, 0.014]), ARC.point_m(np.zeros(1))
    expected = true @ SE3.exp(np.array(FAR_OFF))
    images = [picture(true, rng, 0.3e-3), picture(true, rng, 0.3e-3)]
    assert np.linalg.norm(expected.apply(tip) - true.apply(tip)) > 3e-3
    unsure = np.diag(UNSURE_SD**2)
    assert len(search_starts(expected, unsure, ARC)) > 1 == len(search_starts(expected, unsure / 100, ARC))
    found = sight_needle(images, expected, unsure, ARC, T_CAMERA_FLOOR)
    assert found is not None
    assert np.linalg.norm(found.T_camera_needle.apply(tip) - true.apply(tip)) < 0.5e-3


@pytest.mark.parametrize(("axis", "turn"), [("x", -0.35), ("x", 0.35), ("y", -0.35), ("y", 0.35)])
def test_a_pose_that_does_not_explain_all_the_steel_is_not_taken_for_the_needle(axis, turn):
    """The wire's part near the jaws lies where it is expected, its tip far away: that was once taken for the needle.

    Who says that it may be far away has it found.
    """
    rng = np.random.default_rng(4)
    true, tip = over_floor(rng), ARC.point_m(np.zeros(1))
    held = SE3.from_parts(translation_m=ARC.point_m(np.array([2.36]))[0])
    expected = true @ held @ SE3.from_parts(SO3.axis(axis, turn)) @ held.inverse()
    for sd in (SD, UNSURE_SD):
        found = sight_needle([picture(true, rng)], expected, np.diag(sd**2), ARC, T_CAMERA_FLOOR)
        off_m = np.inf if found is None else np.linalg.norm(found.T_camera_needle.apply(tip) - true.apply(tip))
        assert off_m < 0.5e-3 or (found is None and sd is SD)


def test_a_needle_hidden_by_what_holds_it_or_expected_behind_the_camera_is_not_seen():
    rng = np.random.default_rng(2)
    true = over_floor(rng)
    image = picture(true, rng)
    for z_m in (-0.3, 0.0):
        assert looked([image], SE3.from_parts(true.rotation, [0.0, 0.0, z_m])) is None
    assert looked([image], true, lambda points: np.zeros(len(points))) is None
    assert looked([image], true, lambda points: np.ones(len(points))) is not None


def test_no_image_is_one_sentence():
    with pytest.raises(TrocarError, match="number of images of a needle is 0; give one or more"):
        looked([], T_CAMERA_FLOOR)


# Where the search starts.


def lever_of(tip):
    """Return how the tip moves with a twist of the needle (3, 6)."""
    return np.array([np.concatenate([np.eye(3)[k], np.cross(tip, np.eye(3)[k])]) for k in range(3)])


def test_the_search_starts_where_the_needle_is_likeliest_so_many_sds_away():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6)) * np.repeat([1e-3, 0.1], 3)[:, None]
    covariance = root @ root.T
    T, lever = over_floor(rng), lever_of(ARC.point_m(np.zeros(1))[0])
    variance, axes = np.linalg.eigh(lever @ covariance @ lever.T)
    for away, starts in ((1.5, search_starts(T, covariance, ARC)), (3.0, search_starts(T, covariance, ARC, 3.0))):
        twists = [(T.inverse() @ start).log() for start in starts]
        np.testing.assert_allclose(twists[0], 0.0, atol=1e-12)
        assert len(twists) == 7 and variance[0] > 0.8e-3**2
        for k, twist in enumerate(twists[1:]):
            sd, axis = np.sqrt(variance[k // 2]), axes[:, k // 2]
            np.testing.assert_allclose(lever @ twist, (away if k % 2 == 0 else -away) * sd * axis, atol=1e-9)
            assert np.sqrt(twist @ np.linalg.solve(covariance, twist)) == pytest.approx(away, rel=1e-6)


def test_what_is_found_says_how_many_pixels_show_it_and_how_they_scatter():
    rng = np.random.default_rng(2)
    true = over_floor(rng)
    image = picture(true, rng, 0.2e-3)
    found = looked([image], true)
    assert found is not None
    steel = (image.color == made_up_needle.STEEL_RGB).all(axis=2).sum()
    assert 0.9 * steel < found.pixels <= steel
    assert 0.1e-3 < found.depth_sd_m < 0.25e-3, "of depth across the wire"


def test_what_scatters_far_more_than_the_camera_is_no_needle():
    rng = np.random.default_rng(2)
    true = over_floor(rng)
    assert looked([picture(true, rng, 0.5e-3)], true) is not None
    image = picture(true, rng, 0.0)
    steel = (image.color == made_up_needle.STEEL_RGB).all(axis=2)
    image.depth_m[steel] += rng.uniform(-2.5e-3, 2.5e-3, steel.sum()).astype(np.float32)
    assert looked([image], true) is None


@pytest.mark.parametrize("axis", range(6))
def test_a_needle_is_found_from_two_millimetres_or_a_sixth_of_a_radian_away(axis, monkeypatch):
    """Some SDs away, in steps of .5 mm and .1 rad at most; its turn about its centre shows at its ends alone."""
    tried = []
    monkeypatch.setattr(perception, "normal_equations", lambda *at: tried.append(at[1]) or normal_equations(*at))
    rng = np.random.default_rng(5)
    true = over_floor(rng)
    image = picture(true, rng)
    for sign in (1.0, -1.0):
        off = sign * np.where(np.arange(6) == axis, [1.8e-3] * 3 + [0.16] * 3, 0.0)
        found = looked([image, image], true @ SE3.exp(off))
        assert found is not None
        error = (true.inverse() @ found.T_camera_needle).log()
        assert np.abs(error[:3]).max() < 0.2e-3 and np.abs(error[3:5]).max() < 0.05
        steps = np.abs([(a.inverse() @ b).log() for a, b in pairwise(tried)])
        assert steps[:, :3].max() < 0.501e-3 and steps[:, 3:].max() < 0.1001
        assert axis != 1 or steps[:, :3].max() > 0.499e-3, "it is slowed down along the rays"
        tried.clear()


# How far evidence is from a pose, by hand and by small twists of the needle.


T_CAMERA_NEEDLE = over_floor(np.random.default_rng(0))
T_NEEDLE = T_CAMERA_NEEDLE.inverse()
NONE, NO_RAYS, PIXEL_M = np.zeros((0, 3)), np.zeros((0, 9, 3)), 0.2e-3
ALONG = np.linspace(0.3, ARC.arc_rad - 0.3, 7)


def beside(*distances_m, angle=1.3):
    """Return places (n, 1, 3) in the camera's frame so far out of the wire's surface, in the needle's plane."""
    out = ARC.point_m(np.array([angle]))[0] / ARC.radius_m
    at = [(ARC.radius_m + 0.5 * ARC.wire_m + distance) * out for distance in distances_m]
    return T_CAMERA_NEEDLE.apply(np.array(at))[:, None]


def evidence(points=NONE, through=NO_RAYS, past=NO_RAYS, pixel_m=PIXEL_M):
    return NeedleEvidence(points, through, past, pixel_m)


def twisted(twist):
    return T_CAMERA_NEEDLE @ SE3.exp(twist)


def slopes_of(value):
    """Return how a function of the needle's pose changes with each number of a twist."""
    steps = 1e-6 * np.eye(6)
    return np.stack([(value(twisted(step)) - value(twisted(-step))) / 2e-6 for step in steps], axis=-1)


# Rays against the wire.


def test_a_ray_is_as_far_from_the_wire_as_its_nearest_place():
    rng = np.random.default_rng(1)
    places = T_CAMERA_NEEDLE.apply(rng.uniform(-0.012, 0.012, (20, 5, 3)))
    distance, by = ray_distances(places, T_NEEDLE, ARC)
    each = ARC.distance_m(T_NEEDLE.apply(places.reshape(-1, 3))).reshape(20, 5)
    np.testing.assert_allclose(distance, each.min(axis=1))
    numeric = slopes_of(lambda T: ray_distances(places, T.inverse(), ARC)[0])
    smooth = np.sort(each, axis=1)[:, 1] - distance > 1e-4
    np.testing.assert_allclose(by[smooth], numeric[smooth], atol=1e-4)


# Points behind the wire's front.


def met():
    """Return (rays, depth) of some rays that meet the wire somewhere across it."""
    middle = T_CAMERA_NEEDLE.apply(ARC.point_m(np.repeat(ALONG, 3)))
    rays = middle / middle[:, 2:]
    rays[:, :2] += np.tile([[-0.3e-3, 0.1e-3], [0.0, 0.0], [0.2e-3, 0.2e-3]], (7, 1)) / middle[:, 2:]
    depth, is_met = first_met(T_CAMERA_NEEDLE, rays)
    return rays[is_met], depth[is_met]


def sine_to_wire(rays, depth):
    p = T_NEEDLE.apply(rays * depth[:, None])
    ray = T_NEEDLE.rotation.apply(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    return np.linalg.norm(np.cross(ray, ARC.tangent(ARC.behind_tip_rad(p))), axis=1)


@pytest.mark.parametrize("deeper_m", [-1e-3, 0.0, 0.5e-3, 1e-3])
def test_points_are_as_far_behind_the_front_as_they_are_along_their_rays_counted_across_the_wire(deeper_m):
    rays, depth = met()
    length = np.linalg.norm(rays, axis=1)
    behind, _ = depth_residuals(rays * (depth + deeper_m / length)[:, None], T_NEEDLE, ARC)
    assert len(behind) == len(rays) > 12
    np.testing.assert_allclose(behind, deeper_m * sine_to_wire(rays, depth), atol=0.06e-3)


def test_on_the_wires_middle_line_a_point_is_half_its_thickness_behind_the_front():
    middle = T_CAMERA_NEEDLE.apply(ARC.point_m(ALONG))
    behind, by = depth_residuals(middle, T_NEEDLE, ARC)
    np.testing.assert_allclose(behind, 0.5 * ARC.wire_m, atol=1e-9)
    numeric = slopes_of(lambda T: depth_residuals(middle, T.inverse(), ARC)[0])
    np.testing.assert_allclose(by, numeric, atol=1e-3)


def test_a_point_that_scattered_beside_the_wire_is_behind_its_middle():
    """Its ray misses: there is no front, so that it is as far behind as along the ray."""
    plane = SE3.from_parts(SO3.identity(), [0.0, 0.0, 0.3])  # a needle that faces the camera
    for deeper_m in (-0.4e-3, 0.7e-3):
        ray = np.array([[0.0, -(ARC.radius_m + ARC.wire_m) / 0.3, 1.0]])
        turned = plane @ SE3.from_parts(SO3.axis("z", -1.0))  # so that this place is not the tip
        behind, _ = depth_residuals(ray * (0.3 + deeper_m), turned.inverse(), ARC)
        np.testing.assert_allclose(behind, deeper_m, rtol=0.02)


@pytest.mark.parametrize(("sine", "is_told"), [(0.3, False), (0.5, True)])
def test_depth_tells_nothing_about_a_wire_seen_almost_along_it(sine, is_told):
    angle = 2.0
    middle, along = ARC.point_m(np.array([angle]))[0], ARC.tangent(np.array([angle]))[0]
    ahead = np.sqrt(1 - sine**2) * along + [0.0, 0.0, sine]
    T = SE3.from_parts(SO3.identity(), ahead * 0.3 - middle)  # the camera at the origin sees it so
    R = SO3.between(ahead, [0.0, 0.0, 1.0])
    turned = SE3.from_parts(R) @ T
    behind, by = depth_residuals(turned.apply(middle)[None], turned.inverse(), ARC)
    assert len(behind) == len(by) == int(is_told)


def test_points_beyond_the_ends_tell_nothing():
    beyond = np.stack([ARC.point_m(np.array([end]))[0] for end in (-0.1, 0.1, ARC.arc_rad - 0.1, ARC.arc_rad + 0.1)])
    behind, _ = depth_residuals(T_CAMERA_NEEDLE.apply(beyond), T_NEEDLE, ARC)
    assert len(behind) == 2


# All of it.


def cost(found, T):
    """Return what the fit makes small: a Cauchy cost of all residuals, in SDs."""
    missed, entered = ray_distances(found.through, T.inverse(), ARC)[0], ray_distances(found.past, T.inverse(), ARC)[0]
    off = np.concatenate([np.maximum(missed, 0.0), np.minimum(entered, 0.0)]) / (RAY_SD_PX * found.pixel_m)
    off = np.append(off, depth_residuals(found.points, T.inverse(), ARC)[0] / POINT_SD_M)
    return (0.5 * ROBUST**2 * np.log1p((off / ROBUST) ** 2)).sum() / TOGETHER


def test_the_gradient_is_that_of_a_robust_cost():
    """Of rays that meet steel and miss the wire, rays that pass and enter it, and points on the wire."""
    middle = T_CAMERA_NEEDLE.apply(ARC.point_m(ALONG))
    found = evidence(middle, beside(0.3e-3, 0.02e-3, -0.2e-3), beside(-0.1e-3, -0.2e-3, 0.4e-3, angle=2.4))
    _, gradient, _ = normal_equations(found, T_CAMERA_NEEDLE, ARC)
    numeric = slopes_of(lambda T: cost(found, T))
    np.testing.assert_allclose(gradient, numeric, rtol=2e-3, atol=2e-3 * np.abs(numeric).max())


@pytest.mark.parametrize("past", [False, True])
def test_one_ray_tells_by_how_much_it_is_off_in_one_direction(past):
    off_m = 0.04e-3
    places = beside(-off_m if past else off_m)
    _, by = ray_distances(places, T_NEEDLE, ARC)
    found = evidence(past=places) if past else evidence(through=places)
    information, gradient, left = normal_equations(found, T_CAMERA_NEEDLE, ARC)
    sds = off_m / (0.25 * PIXEL_M)
    weight = 1.0 / (1.0 + (sds / 1.5) ** 2) / 4.0
    np.testing.assert_allclose(information, weight * np.outer(by, by) / (0.25 * PIXEL_M) ** 2, rtol=1e-6)
    np.testing.assert_allclose(gradient, (-1 if past else 1) * weight * sds * by[0] / (0.25 * PIXEL_M), rtol=1e-6)
    assert left == np.inf


def test_what_is_left_of_the_points_is_the_sd_of_their_depth_whatever_a_few_do():
    rng = np.random.default_rng(2)
    middle = T_CAMERA_NEEDLE.apply(ARC.point_m(np.linspace(0.2, ARC.arc_rad - 0.2, 400)))
    rays = middle / middle[:, 2:]
    depth, is_met = first_met(T_CAMERA_NEEDLE, rays)
    assert is_met.all()
    noise = 0.2e-3 * rng.standard_normal(400) + np.where(np.arange(400) < 12, 4e-3, 0.0)
    points = rays * (depth + noise / sine_to_wire(rays, depth) / np.linalg.norm(rays, axis=1))[:, None]
    *_, left = normal_equations(evidence(points), T_CAMERA_NEEDLE, ARC)
    assert left == pytest.approx(0.2e-3, rel=0.15)


def test_poses_are_compared_by_the_rays_that_they_do_not_explain():
    found = evidence(through=beside(0.1e-3, -0.1e-3, 0.3e-3), past=beside(-0.05e-3, 0.2e-3))
    sds = np.array([0.1e-3, 0.3e-3, 0.05e-3]) / (0.25 * PIXEL_M)
    assert ray_cost(found, T_CAMERA_NEEDLE, ARC) == pytest.approx(np.log1p((sds / 1.5) ** 2).sum(), rel=1e-6)
    assert ray_cost(found, twisted([0, 0, 2e-3, 0, 0, 0]), ARC) > ray_cost(found, T_CAMERA_NEEDLE, ARC)


def test_a_ray_contradicts_a_pose_by_half_a_millimetre_aside_or_a_quarter_of_the_wire_inside():
    found = evidence(
        through=beside(0.4e-3, 0.6e-3, 0.8e-3, 1.1e-3, -0.1e-3),
        past=beside(-0.2 * ARC.wire_m, -0.3 * ARC.wire_m, -0.45 * ARC.wire_m, 0.2e-3),
    )
    assert contradicting_share(found, T_CAMERA_NEEDLE, ARC) == pytest.approx((3 + 2) / 5)
    assert contradicting_share(evidence(past=beside(-0.4e-3)), T_CAMERA_NEEDLE, ARC) == 1.0
    assert contradicting_share(evidence(through=beside(0.9e-3)), T_CAMERA_NEEDLE, ARC) == 1.0
