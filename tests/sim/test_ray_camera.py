from dataclasses import replace

import mujoco
import numpy as np
import pytest
from random_cells import overhead, random_scene, world_of

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, load_station
from trocar.perception.depth import pixel_rays
from trocar.perception.image import Intrinsics
from trocar.sim.ray_camera import RayCamera, _Raster

SMALL = load_station("peg-transfer").cameras["overhead"].model.binned(4)
LAMP_M = (0.12, 0.0, 0.0)
DOWN = SE3.from_parts(SO3(np.diag([1.0, -1.0, -1.0])), [0.0, 0.0, 0.6])
SPHERE = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
<geom type="sphere" size=".05" pos=".02 .01 .1" rgba=".8 .2 .1 1"/></worldbody></mujoco>"""


def state(xml: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_depth_is_that_of_plane_and_sphere():
    model, data = state(SPHERE)
    depth, geom, _ = RayCamera(model, SMALL, DOWN, LAMP_M, SensorFlaws.none()).render_exact(data)
    rays = pixel_rays(SMALL)
    centre = DOWN.inverse().apply([0.02, 0.01, 0.1])
    a, b, c = np.sum(rays**2, -1), rays @ centre, centre @ centre - 0.05**2
    under = b * b - a * c
    expected = np.where(under > 0, (b - np.sqrt(np.maximum(under, 0))) / a, 0.6)
    assert np.abs(depth - expected).max() < 1e-9
    assert ((geom == 1) == (under > 0)).all()


def test_without_flaws_the_image_is_exact():
    model, data = state(SPHERE)
    camera = RayCamera(model, SMALL, DOWN, LAMP_M, SensorFlaws.none())
    image = camera.render(data, np.random.default_rng(0))
    depth, _, color = camera.render_exact(data)
    assert (image.depth_m == depth.astype(np.float32)).all()
    assert (image.color == color).all()


def test_same_seed_same_bytes_and_other_seed_other_noise():
    scene, _ = random_scene(np.random.default_rng(5))
    model, data = world_of(scene)
    camera = overhead(model, 4)
    first, second, third = (camera.render(data, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.depth_m.tobytes() == second.depth_m.tobytes()
    assert first.color.tobytes() == second.color.tobytes()
    assert first.depth_m.tobytes() != third.depth_m.tobytes()


def test_noise_has_the_level_asked_for():
    model, data = state(SPHERE)
    flaws = SensorFlaws(waviness_m=0.0, edge_mixed=0.0)
    camera = RayCamera(model, SMALL, DOWN, LAMP_M, flaws)
    depth, geom, _ = camera.render_exact(data)
    image = camera.render(data, np.random.default_rng(0))
    plane = (geom == 0) & np.isfinite(image.depth_m)
    cosine = 1 / np.linalg.norm(pixel_rays(SMALL), axis=-1)
    assert np.std(((image.depth_m - depth) * cosine)[plane]) == pytest.approx(flaws.axial_m, rel=0.03)


@pytest.mark.parametrize("lamp_m", [LAMP_M, (-0.05, 0.15, 0.02)])
def test_the_projector_leaves_a_shadow_without_depth(lamp_m):
    model, data = state(SPHERE)
    only_shadow = SensorFlaws(**{**SensorFlaws.none().__dict__, "shadow": True})
    camera = RayCamera(model, SMALL, DOWN, lamp_m, only_shadow)
    depth, geom, _ = camera.render_exact(data)
    lost = np.isnan(camera.render(data, np.random.default_rng(0)).depth_m)
    point = DOWN.apply(pixel_rays(SMALL) * depth[..., None])
    source = DOWN.apply(lamp_m)
    toward = source - point
    centre = np.array([0.02, 0.01, 0.1])
    along = np.clip(np.sum((centre - point) * toward, -1) / np.sum(toward**2, -1), 0, 1)
    distance = np.linalg.norm(point + along[..., None] * toward - centre, axis=-1)
    floor = (geom == 0) & (np.abs(distance - 0.05) > 1e-4)
    assert (lost == (distance < 0.05))[floor].all()
    assert lost[floor].sum() > 20


def test_refuses_a_pose_that_is_none():
    model, _ = state(SPHERE)
    with pytest.raises(TrocarError, match="one finite pose"):
        RayCamera(model, SMALL, SE3.identity((2,)), LAMP_M, SensorFlaws())


SHOWER = """<mujoco><asset><mesh name="cone" vertex="0 0 0 .12 0 0 0 .05 0 0 0 .03"/></asset><worldbody>
<geom type="plane" size="1 1 .1"/><geom type="box" size=".1 .02 .05" pos=".1 .05 .05"/>
<body name="a"><freejoint/><geom type="box" size=".06 .02 .01" mass="1"/></body>
<body name="b"><freejoint/><geom type="mesh" mesh="cone" mass="1"/></body>
<body name="c"><freejoint/><geom type="capsule" size=".01" fromto="0 0 -.3 0 0 .3" mass="1"/></body>
<body name="d"><freejoint/><geom type="sphere" size=".02" mass="1"/></body></worldbody></mujoco>"""
WIDE = Intrinsics(60, 44, 50.0, 50.0, 29.5, 21.5)
ASKEW = SE3.from_parts(SO3(np.diag([1.0, -1.0, -1.0])) @ SO3.exp([0.2, -0.3, 0.4]), [-0.1, 0.05, 0.3])


def shower(model, data, rng):
    """Put every body somewhere round the camera: before it, beside it, behind it, through its plane."""
    for number in range(model.nbody - 1):
        data.qpos[7 * number : 7 * number + 3] = ASKEW.translation_m + rng.uniform(
            [-0.12, -0.12, -0.25], [0.12, 0.12, 0.05]
        )
        turn = rng.normal(size=4)
        data.qpos[7 * number + 3 : 7 * number + 7] = turn / np.linalg.norm(turn)
    mujoco.mj_forward(model, data)


def test_wherever_bodies_are_round_the_camera_it_sees_what_every_ray_by_itself_would():
    model, data = state(SHOWER)
    rng = np.random.default_rng(0)
    camera = RayCamera(model, WIDE, ASKEW, (0.05, 0.02, 0.01), SensorFlaws.none())
    covered, seen = [], []
    for _ in range(30):
        shower(model, data, rng)
        depth, geom, _ = camera.render_exact(data)
        every_depth, every_geom, normal = camera._cast(model, data, ASKEW.translation_m, camera._rays_world)
        assert (geom.ravel() == every_geom).all()
        np.testing.assert_array_equal(depth.ravel(), every_depth)
        lit = camera._view(data, shadow=True).lit
        assert (lit == camera._lit(model, data, every_depth, normal, np.arange(len(lit)))).all()
        covered.append(camera._raster.covered(model, data, camera._moving, ASKEW)[camera._cell].mean())
        seen.append((every_geom >= 2).mean())
    assert np.mean(seen) > 0.05 and np.max(seen) > 0.2
    assert np.mean(covered) < 3.0 * np.mean(seen), "or else nothing is saved"


def test_a_body_close_to_the_lens_is_not_lost():
    """Its corners are before and behind the plane 5 mm off; from beside the picture it reaches into it."""
    model, data = state(SHOWER)
    camera = RayCamera(model, WIDE, ASKEW, LAMP_M, SensorFlaws.none())
    for shift in np.linspace(-0.06, 0.06, 13):
        data.qpos[:] = np.tile([5.0, 5.0, 5.0, 1.0, 0, 0, 0], 4)
        data.qpos[:3] = ASKEW.apply([shift, 0.02, 0.012])
        data.qpos[3:7] = (ASKEW.rotation @ SO3.exp([0.0, 0.6, 0.3])).as_quaternion()
        mujoco.mj_forward(model, data)
        _, geom, _ = camera.render_exact(data)
        _, every_geom, _ = camera._cast(model, data, ASKEW.translation_m, camera._rays_world)
        assert (geom.ravel() == every_geom).all()


@pytest.mark.parametrize("shadow", [False, True])
def test_a_rectangle_of_the_pixels_is_that_part_of_the_picture(shadow):
    model, data = state(SHOWER)
    rng, flaws = np.random.default_rng(1), replace(SensorFlaws.none(), shadow=shadow)
    whole = RayCamera(model, WIDE, ASKEW, (0.05, 0.02, 0.01), flaws)
    fresh = RayCamera(model, WIDE, ASKEW, (0.05, 0.02, 0.01), flaws)
    read_out = np.zeros(fresh.size, bool)
    for corner, size in (((20, 12), (30, 17)), ((0, 20), (17, 24)), ((40, 0), (20, 44)), ((10, 10), (40, 20))):
        (u, v), (width, height) = corner, size
        part, rectangle = fresh.cropped(data, corner, size), np.s_[v : v + height, u : u + width]
        assert part.size == (height, width)
        read_out[rectangle] = True
        assert (fresh._fixed[shadow].cast == read_out.ravel()).all(), "fixed objects are cast once, where they are read"
        for _ in range(3):
            shower(model, data, rng)
            for cut, full in zip(part.render_exact(data), whole.render_exact(data), strict=True):
                np.testing.assert_array_equal(cut, full[rectangle])
            if shadow:
                cut, full = (camera.render(data, np.random.default_rng(0)) for camera in (part, whole))
                np.testing.assert_array_equal(cut.depth_m, full.depth_m[rectangle])
                np.testing.assert_array_equal(cut.color, full.color[rectangle])


def test_what_a_camera_may_not_see_is_not_there_for_it():
    model, data = state(
        """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
        <body><freejoint/><geom type="sphere" size=".05" group="3" mass="1"/></body>
        <body><freejoint/><geom type="sphere" size=".05" group="4"/><geom type="sphere" size=".05" group="5"/></body>
        <body><freejoint/><geom type="sphere" size=".05" rgba="1 0 0 0"/></body>
        <body pos=".1 0 0"><freejoint/><geom type="sphere" size=".05" group="2"/></body>
        <body pos="-.1 0 0"><freejoint/><geom type="sphere" size=".05" group="1"/></body></worldbody></mujoco>"""
    )
    _, geom, _ = RayCamera(model, SMALL, DOWN, LAMP_M, SensorFlaws.none()).render_exact(data)
    assert set(np.unique(geom)) == {0, 5, 6}


def test_light_falls_off_with_the_incidence_and_into_nothing_nobody_sees():
    model, data = state('<mujoco><worldbody><geom type="plane" size="1 1 .1" rgba=".2 .4 .2 1"/></worldbody></mujoco>')
    tilted = RayCamera(model, WIDE, ASKEW, (0.0, 0.0, 0.0), SensorFlaws.none())
    view = tilted._view(data, shadow=False)
    rays = pixel_rays(WIDE).reshape(-1, 3)
    up = ASKEW.rotation.inverse().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(view.cosine, -rays @ up / np.linalg.norm(rays, axis=1), rtol=1e-5)
    points = ASKEW.apply(rays * view.depth[:, None])
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-9)
    away = RayCamera(model, WIDE, SE3.from_parts(SO3.identity(), [0, 0, 0.1]), LAMP_M, SensorFlaws.none())
    depth, geom, color = away.render_exact(data)  # looks up into the sky
    assert np.isnan(depth).all() and (geom == -1).all() and not color.any()
    dark, bright = (tilted.render_color(data, np.random.default_rng(0), gain).astype(float) for gain in (0.2, 0.4))
    assert bright.mean() == pytest.approx(2 * dark.mean(), rel=0.02) and bright.max() < 255


def test_pixels_combined_see_the_same_with_fewer_rays():
    model, data = state(SPHERE)
    camera = RayCamera(model, SMALL, DOWN, LAMP_M, SensorFlaws.none())
    half = camera.binned(2)
    assert half.size == (SMALL.height // 2, SMALL.width // 2)
    fine, coarse = (np.mean(eye.render_exact(data)[1] == 1) for eye in (camera, half))
    assert coarse == pytest.approx(fine, rel=0.05)


def test_cells_of_a_map_are_two_pixels_wide_and_numbered_row_by_row():
    """A focal length of 16 pixels: 8 cells for a direction of 1, and 4 of margin at each side."""
    raster = _Raster(np.array([-0.25, 1.0]), np.array([-0.5, 0.25]), 16.0)
    assert raster.shape == (16, 20)  # two more than needed
    for x, y, cell in (
        (-0.74, -0.99, 0),
        (-0.25, -0.5, 4 * 20 + 4),
        (0.03, 0.03, 8 * 20 + 6),
        (1.74, 0.9, 15 * 20 + 19),
    ):
        assert raster.index(np.array([x]), np.array([y])) == cell
    for off in ((-0.76, 0.0), (1.76, 0.0), (0.0, -1.01), (0.0, 1.01)):
        assert raster.index(*np.array(off)[:, None]) == 16 * 20, "they share one cell"


def test_a_part_of_a_map_numbers_the_same_directions_and_some_round_them():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.7, 0.5, 300), rng.uniform(-0.4, 0.6, 300)
    raster = _Raster(x, y, 60.0)
    some = (x > 0.0) & (y < 0.2) & (y > -0.1)
    cells = raster.index(x[some], y[some])
    outside = raster.index(np.array([9.0]), np.array([9.0]))
    smaller, numbers = raster.part(np.append(cells, outside))
    assert (smaller.index(x[some], y[some]) == numbers[:-1]).all() and numbers[-1] == np.prod(smaller.shape)
    assert np.prod(smaller.shape) < 0.4 * np.prod(raster.shape)
    last = np.prod(smaller.shape)
    low, high = np.array([x[some].min(), y[some].min()]), np.array([x[some].max(), y[some].max()])
    for axis in (0, 1):
        for end, sign in ((low, -1), (high, 1)):
            beside = (low + high) / 2
            beside[axis] = end[axis]
            inside, beyond = ((beside + sign * away * np.eye(2)[axis] / 30)[:, None] for away in (3, 6))
            assert smaller.index(*inside) != last, "a margin of four cells"
            assert smaller.index(*beyond) == last
    same, unchanged = raster.part(outside)
    assert same is raster and (unchanged == outside).all()
