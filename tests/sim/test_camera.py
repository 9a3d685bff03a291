import mujoco
import numpy as np
import pytest
from random_cells import overhead, random_scene, world_of

from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.perception.depth import pixel_rays
from trocar.sim.camera import RayCamera
from trocar.station import SensorFlaws, load_station

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


def test_casting_only_what_may_hit_changes_nothing():
    scene, _ = random_scene(np.random.default_rng(5))
    model, data = world_of(scene)
    camera = overhead(model, 2, SensorFlaws.none())
    depth, geom, _ = camera.render_exact(data)
    eye = camera.T_world_camera.translation_m
    every_depth, every_geom, normal = camera._cast(model, data, eye, camera._rays_world)
    assert (geom.ravel() == every_geom).all()
    assert np.abs(depth.ravel() - every_depth).max() < 1e-12
    every_lit = camera._lit(model, data, every_depth, normal, np.arange(len(every_depth)))
    lit = camera._view(data, shadow=True).lit
    assert 0.5 < lit.mean() < 0.999
    assert (lit == every_lit).all()


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
        RayCamera(model, SMALL, SE3.identity((2,)), LAMP_M)
