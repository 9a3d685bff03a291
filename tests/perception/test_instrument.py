"""The wrist in made-up depth images, and in one of the simulated camera, flaws and all."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import PSM_CLASSIC, fk
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.lab.flaws import Difficulty
from trocar.lab.session import draw_session
from trocar.perception.depth import pixel_rays
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.perception.instrument import _gather, _normal_equations, sight
from trocar.perception.instrument_solids import InstrumentSolids
from trocar.sim.calibration_cells import EmptyTable
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.world import World

ARM, Q = PSM_CLASSIC, np.array([0.1, 0.1, 0.15, 0.4, 0.3, -0.4])
JAW_RAD = 0.9
LENS = Intrinsics(80, 80, 600.0, 610.0, 39.5, 39.5)
P_TIP = fk(ARM, Q).translation_m
T_BASE_CAMERA = SE3.from_parts(SO3.axis("x", np.pi - 1.1) @ SO3.axis("z", 0.3), P_TIP) @ SE3.from_parts(
    translation_m=[0.005, 0.005, -0.4]
)
WALL_M = 0.1
"""Behind the tip."""
RAYS = pixel_rays(LENS).reshape(-1, 3)


def made_up(q=Q, wall_m=WALL_M):
    """Return an image of the instrument before a wall, without noise: each ray ends where it meets one of them."""
    solids, length = InstrumentSolids.of(ARM, q, JAW_RAD), np.linalg.norm(RAYS, axis=1)
    depth = np.full(len(RAYS), 0.3)
    on = np.arange(len(RAYS))
    for _ in range(60):  # forward by the distance to the instrument
        ahead = solids.distance_m(T_BASE_CAMERA.apply(RAYS[on] * depth[on, None]))
        depth[on] += ahead / length[on]
        on = on[(ahead > 1e-6) & (depth[on] < 0.4 + wall_m)]
    depth = np.minimum(depth, 0.4 + wall_m).reshape(80, 80).astype(np.float32)
    return RgbdImage(np.zeros((80, 80, 3), np.uint8), depth, LENS)


IMAGE = made_up()
SOLIDS = InstrumentSolids.of(ARM, Q, JAW_RAD)


def gathered(image=IMAGE, q=Q, T_base_floor=None):
    return _gather(image, T_BASE_CAMERA, ARM, q, JAW_RAD, T_base_floor)


def turned(by):
    return Q + np.append(np.zeros(3), by)


# What an image shows.


def test_points_on_the_instrument_are_those_near_it_and_near_the_tip():
    points, _ = gathered()
    depth = IMAGE.depth_m.ravel().astype(np.float64)
    all_ = T_BASE_CAMERA.apply(RAYS * depth[:, None])
    seen = (depth < 0.45) & (np.linalg.norm(all_ - P_TIP, axis=1) < 0.030)
    assert abs(len(points) - seen.sum()) <= 2 and 300 < len(points) < (depth < 0.45).sum() - 100
    assert np.abs(SOLIDS.distance_m(points)).max() < 0.02e-3


def test_points_so_near_to_where_the_instrument_is_expected_are_taken_for_it():
    """Something covers all of it, 2 mm to 9 mm before it from one side to the other: what is within 4 mm counts."""
    nearer_m = np.linspace(2e-3, 9e-3, 80)[:, None].astype(np.float32)
    depth = np.where(IMAGE.depth_m < 0.45, IMAGE.depth_m - nearer_m, IMAGE.depth_m)
    points, _ = gathered(replace(IMAGE, depth_m=depth))
    all_ = T_BASE_CAMERA.apply(RAYS * depth.reshape(-1, 1).astype(np.float64))
    apart = SOLIDS.distance_m(all_[np.linalg.norm(all_ - P_TIP, axis=1) < 0.030])
    assert (apart < 3.9e-3).sum() - 2 <= len(points) <= (apart < 4.1e-3).sum() + 2
    assert 60 < len(points) < (apart < 7e-3).sum() - 30


def test_rays_that_pass_beside_it_and_end_far_behind_it_are_followed():
    _, rays = gathered()
    depth = IMAGE.depth_m.ravel()
    past = RAYS[depth > 0.45]
    places = past[::5, None] * np.arange(0.380, 0.4205, 0.5e-3)[:, None]
    distance = SOLIDS.distance_m(T_BASE_CAMERA.apply(places).reshape(-1, 3)).reshape(len(past[::5]), -1)
    near, about = (distance[:, 10:62].min(axis=1) < 1.5e-3).sum(), (distance.min(axis=1) < 1.7e-3).sum()
    assert 20 < 0.9 * near < len(rays) / 5 < 1.1 * about
    camera = T_BASE_CAMERA.inverse().apply(rays)
    np.testing.assert_allclose(camera / camera[..., 2:], np.repeat(camera[:, :1] / camera[:, :1, 2:], 13, 1))
    sampled = SOLIDS.distance_m(rays.reshape(-1, 3)).reshape(rays.shape[:2])
    assert sampled.min(axis=1).max() < 1.6e-3
    np.testing.assert_allclose(np.diff(camera[..., 2], axis=1), 0.7e-3, atol=1e-9)
    middle = sampled.argmin(axis=1)
    assert abs(np.median(middle) - 6) <= 1 and ((middle > 1) & (middle < 11)).mean() > 0.9


@pytest.mark.parametrize(("wall_m", "counts"), [(0.010, False), (0.018, True)])
def test_what_lies_close_behind_the_tip_is_no_background(wall_m, counts):
    _, rays = gathered(made_up(wall_m=wall_m))
    assert (len(rays) > 50) == counts and (counts or not len(rays))


def with_points(count):
    depth = np.full((80, 80), 0.5, np.float32)
    on = np.argwhere(IMAGE.depth_m < 0.45)[20 : 20 + count]  # from the fingers' ends on
    depth[on[:, 0], on[:, 1]] = IMAGE.depth_m[on[:, 0], on[:, 1]]
    return replace(IMAGE, depth_m=depth)


def test_sixty_points_are_enough():
    found = gathered(with_points(60))
    assert found is not None and len(found[0]) == 60
    assert gathered(with_points(59)) is None
    assert sight(with_points(59), T_BASE_CAMERA, ARM, Q, JAW_RAD) is None


def test_a_camera_that_looks_elsewhere_sees_nothing():
    away = T_BASE_CAMERA @ SE3.from_parts(translation_m=[0.3, 0.0, 0.0])
    assert _gather(IMAGE, away, ARM, Q, JAW_RAD, None) is None


def test_pixels_without_depth_say_nothing():
    depth = IMAGE.depth_m.copy()
    depth[::2] = np.nan
    points, rays = gathered(replace(IMAGE, depth_m=depth))
    whole_points, whole_rays = gathered()
    assert len(points) == pytest.approx(len(whole_points) / 2, rel=0.1)
    assert len(rays) == pytest.approx(len(whole_rays) / 2, rel=0.2)


def test_what_lies_below_the_floor_is_no_part_of_the_instrument():
    points, rays = gathered()
    T_base_floor = T_BASE_CAMERA @ SE3.from_parts(
        SO3.axis("y", np.pi / 2 + 0.2), [0.004, 0.0, 0.4]
    )  # steep: rays cross it
    above, past = gathered(T_base_floor=T_base_floor)
    height = T_base_floor.inverse().apply(points)[:, 2]
    assert len(above) == (height > 0.0).sum() and 100 < len(above) < len(points) - 50
    height = T_base_floor.inverse().apply(rays)[..., 2].min(axis=1)
    assert len(past) == (height > 0.0).sum() and 10 < len(past) < len(rays) - 10
    everything = gathered(T_base_floor=T_BASE_CAMERA @ SE3.from_parts(SO3.axis("x", np.pi), [0.0, 0.0, 0.6]))
    assert len(everything[0]) == len(points) and len(everything[1]) == len(rays)
    unseen = gathered(made_up(wall_m=0.005), T_base_floor=T_base_floor)
    assert unseen is not None and not len(unseen[1])


# How it is fitted.


def cost(x, points, rays):
    """Return what the fit makes small: a Cauchy cost in SDs of .3 mm; rays may go .1 mm deep."""
    solids = InstrumentSolids.of(ARM, turned(x[:3]), JAW_RAD)
    off = solids.distance_m(points - x[3:])
    if len(rays):
        deepest = solids.distance_m((rays - x[3:]).reshape(-1, 3)).reshape(rays.shape[:2]).min(axis=1)
        off = np.append(off, np.minimum(deepest + 0.1e-3, 0.0))
    return (0.5 * 1.5**2 * np.log1p((off / 0.3e-3 / 1.5) ** 2)).sum() / 25.0


@pytest.mark.parametrize("with_rays", [True, False])
def test_the_gradient_is_that_of_a_robust_cost(with_rays):
    points, rays = gathered()
    rays = rays if with_rays else rays[:0]
    x = np.array([0.06, -0.05, 0.08, 0.3e-3, -0.4e-3, 0.2e-3])
    _, gradient, _ = _normal_equations(ARM, Q, x, JAW_RAD, points, rays)
    steps = np.diag(np.repeat([1e-6, 1e-9], 3))
    numeric = [(cost(x + step, points, rays) - cost(x - step, points, rays)) / (2 * step.max()) for step in steps]
    np.testing.assert_allclose(gradient, numeric, rtol=0.02, atol=0.01 * np.abs(numeric[3:]).max() * 1e-2)


def test_a_ray_counts_only_as_far_as_it_goes_too_deep():
    """The same places of two rays, moved into a finger or out of it."""
    points, rays = gathered()
    alone = _normal_equations(ARM, Q, np.zeros(6), JAW_RAD, points, rays[:0])
    beside = _normal_equations(ARM, Q, np.zeros(6), JAW_RAD, points, rays)
    for a, b in zip(alone, beside, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    x = np.append(np.zeros(3), 0.5e-3 * np.array([1.0, 0.0, 0.0]))
    without, with_ = (_normal_equations(ARM, Q, x, JAW_RAD, points, some)[0] for some in (rays[:0], rays))
    assert np.linalg.eigvalsh(with_ - without).min() > -1e-6 * np.abs(with_).max()
    assert np.trace(with_[3:, 3:]) > 1.01 * np.trace(without[3:, 3:])


def test_what_a_point_tells_is_its_slope_in_sds_shared_with_its_neighbours():
    points, rays = gathered()
    x = np.append(np.zeros(3), [0.1e-3, 0.2e-3, -0.1e-3])
    distance, slopes = InstrumentSolids.of(ARM, Q, JAW_RAD).slopes(points[:7] - x[3:])
    weight = 1.0 / (1.0 + (distance / 0.3e-3 / 1.5) ** 2) / 25.0 / 0.3e-3**2
    information, gradient, left = _normal_equations(ARM, Q, x, JAW_RAD, points[:7], rays[:0])
    np.testing.assert_allclose(information, (slopes.T * weight) @ slopes, rtol=1e-9)
    np.testing.assert_allclose(gradient, (slopes.T * weight) @ distance, rtol=1e-9, atol=1e-9)
    assert left == pytest.approx(1.48 * np.median(np.abs(distance)))


@pytest.mark.parametrize("off", [(0.08, -0.05, 0.06), (-0.2, 0.1, -0.1)])
def test_without_noise_the_wrist_is_found_and_what_holds_the_search_is_told(off):
    """The prior, .3 rad and 1 mm, pulls against what was seen."""
    expected = turned(off)
    found = sight(IMAGE, T_BASE_CAMERA, ARM, expected, JAW_RAD)
    assert found is not None
    np.testing.assert_allclose(found.q[:3], Q[:3])
    np.testing.assert_allclose(found.q[3:], Q[3:], atol=0.02)
    assert np.linalg.norm(found.shift_m) < 0.15e-3
    x = np.append(found.q[3:] - expected[3:], found.shift_m)
    np.testing.assert_allclose(found.pull, x / np.repeat([0.3, 1e-3], 3) ** 2)
    _, gradient, left = _normal_equations(ARM, expected, x, JAW_RAD, *gathered(q=expected))
    tolerance = 0.05 * np.sqrt(np.diag(found.information))
    assert (np.abs(found.pull + gradient) < tolerance).all(), "it ended where both are in balance"
    assert found.left_m == pytest.approx(left, abs=0.01e-3) and found.left_m < 0.05e-3
    assert found.points == len(gathered(q=expected)[0])


def test_noise_of_the_depth_is_what_is_left():
    noise = 0.2e-3 * np.random.default_rng(0).standard_normal((80, 80))
    found = sight(
        replace(IMAGE, depth_m=IMAGE.depth_m + noise), T_BASE_CAMERA, ARM, turned([0.03, 0.03, 0.03]), JAW_RAD
    )
    assert found is not None and 0.08e-3 < found.left_m < 0.22e-3


def test_a_camera_that_is_registered_beside_its_place_shifts_the_instrument():
    shift = np.array([0.4e-3, -0.3e-3, 0.5e-3])
    found = sight(IMAGE, SE3.from_parts(translation_m=shift) @ T_BASE_CAMERA, ARM, Q, JAW_RAD)
    assert found is not None
    np.testing.assert_allclose(found.shift_m, shift, atol=0.12e-3)
    np.testing.assert_allclose(found.q[3:], Q[3:], atol=0.04)


# The simulated camera.


STATION = replace(load_station("peg-transfer"), difficulty=Difficulty.of("recorded"))
OFF = np.array([0.08, -0.05, 0.06])
SHIFT_SD_M = 0.25e-3
"""Of what errors of the outer joints do to an instrument, from look to look."""


@pytest.fixture(scope="module")
def seen():
    """Return what sees the arm in joints (6,) and its camera in the arm's base."""
    session = draw_session(STATION, np.random.default_rng(3))
    arm, T_world_base, camera = (
        session.models["psm1"],
        session.T_world_base["psm1"],
        session.station.cameras["overhead"],
    )
    T_world_camera = session.T_world_camera["overhead"]
    world = World({"psm1": arm}, {"psm1": T_world_base}, EmptyTable())
    eye = RayCamera(world.model, camera.model, T_world_camera, camera.lamp_m, camera.flaws, Light(gain=camera.gain))

    def look(q, rng):
        world.place_arm("psm1", q, JAW_RAD)
        return eye.render(world.data, rng)

    return look, arm, T_world_base.inverse() @ T_world_camera


def poses(arm, rng, count):
    q = np.tile(STATION.arm("psm1").park_q(), (count, 1))
    q[:, 3:] = rng.uniform([-1.0, -0.7, -0.9], [1.0, 0.7, -0.2], (count, 3))
    return q


def test_the_wrist_is_found_from_where_it_is_expected(seen):
    look, arm, T_base_camera = seen
    rng = np.random.default_rng(0)
    errors, scores = [], []
    for q in poses(arm, rng, 10):
        expected = q.copy()
        expected[3:] += OFF
        shift = SE3.from_parts(translation_m=rng.normal(0.0, SHIFT_SD_M, 3))
        found = sight(look(q, rng), shift @ T_base_camera, arm, expected, JAW_RAD)
        assert found is not None and found.points > 200 and found.left_m < 0.45e-3
        fixed = np.diag(np.repeat([1.0, 1.0 / SHIFT_SD_M**2], 3))
        covariance = np.linalg.inv(found.information + fixed)
        fitted = found.q[3:] + (covariance @ (found.pull - fixed @ np.append(np.zeros(3), found.shift_m)))[:3]
        errors.append(fitted - q[3:])
        scores.append(errors[-1] / np.sqrt(np.diag(covariance))[:3])
    assert (np.median(np.abs(errors), axis=0) < [0.06, 0.03, 0.05]).all(), "started .08 .05 .06 rad off"
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 2.0, "it says how sure it is"


def test_what_is_not_in_the_picture_is_not_seen(seen):
    look, arm, T_base_camera = seen
    q = STATION.arm("psm1").park_q()
    away = q.copy()
    away[0] += 0.3
    assert sight(look(away, np.random.default_rng(0)), T_base_camera, arm, q, JAW_RAD) is None
