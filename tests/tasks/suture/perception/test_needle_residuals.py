"""How far evidence is from a pose, by hand and by small twists of the needle."""

import numpy as np
import pytest

from made_up_needle import ARC, first_met, over_floor
from trocar.geometry import SE3, SO3
from trocar.tasks.suture.perception.needle_evidence import NeedleEvidence
from trocar.tasks.suture.perception.needle_pose import (
    POINT_SD_M,
    RAY_SD_PX,
    ROBUST,
    TOGETHER,
    contradicting_share,
    depth_residuals,
    normal_equations,
    ray_cost,
    ray_distances,
)

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


def test_no_rays_have_no_distances():
    distance, by = ray_distances(NO_RAYS, T_NEEDLE, ARC)
    assert distance.shape == (0,) and by.shape == (0, 6)


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


def test_one_point_tells_its_depth():
    middle = T_CAMERA_NEEDLE.apply(ARC.point_m(np.array([1.3])))
    behind, by = depth_residuals(middle, T_NEEDLE, ARC)
    information, gradient, left = normal_equations(evidence(middle), T_CAMERA_NEEDLE, ARC)
    sds = behind[0] / 0.35e-3
    weight = 1.0 / (1.0 + (sds / 1.5) ** 2) / 4.0
    np.testing.assert_allclose(information, weight * np.outer(by, by) / 0.35e-3**2)
    np.testing.assert_allclose(gradient, weight * sds * by[0] / 0.35e-3)
    assert left == pytest.approx(1.48 * behind[0])


def test_rays_that_a_pose_explains_tell_nothing():
    found = evidence(through=beside(-0.1e-3), past=beside(0.1e-3))
    information, gradient, _ = normal_equations(found, T_CAMERA_NEEDLE, ARC)
    assert not information.any() and not gradient.any()
    assert ray_cost(found, T_CAMERA_NEEDLE, ARC) == 0.0


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


def test_a_camera_that_is_turned_about_itself_is_told_the_same():
    found = evidence(T_CAMERA_NEEDLE.apply(ARC.point_m(ALONG)), beside(0.1e-3), beside(-0.1e-3))
    moved = SE3.from_parts(SO3.axis("x", 0.5))
    other = evidence(moved.apply(found.points), moved.apply(found.through), moved.apply(found.past))
    one, two = normal_equations(found, T_CAMERA_NEEDLE, ARC), normal_equations(other, moved @ T_CAMERA_NEEDLE, ARC)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(a).max())
