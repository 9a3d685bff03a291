"""Grain and wet spots of surfaces, and the noise of an eye."""

import mujoco
import numpy as np
import pytest

from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws
from trocar.perception.image import Intrinsics
from trocar.sim import appearance
from trocar.sim.appearance import AT_ONCE, Appearance, Sight, _grain, _noise
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light, expose

LENS = Intrinsics(160, 120, 200.0, 200.0, 79.5, 59.5)
DOWN = SE3.from_parts(SO3(np.diag([1.0, -1.0, -1.0])), [0.0, 0.0, 0.2])
XML = """<mujoco><asset><material name="foam" roughness="{grain}" specular="{wet}" shininess=".5"/></asset><worldbody>
<body name="box"><freejoint/><geom type="box" size=".03 .03 .01" rgba=".6 .1 .1 1" {material} mass="1"/></body>
<geom type="plane" size="1 1 .1" pos="0 0 -.05" rgba=".5 .5 .5 1"/></worldbody></mujoco>"""


def picture(grain=0.1, wet=0.0, material='material="foam"', shift=(0.0, 0.0)):
    model = mujoco.MjModel.from_xml_string(XML.format(grain=grain, wet=wet, material=material))
    data = mujoco.MjData(model)
    data.qpos[:2] = shift
    mujoco.mj_forward(model, data)
    light = Light(0.4, 0.1)
    camera = RayCamera(model, LENS, DOWN, (0.0, 0.0, 0.0), SensorFlaws.none(), light, Appearance(model))
    return camera.render_color(data, np.random.default_rng(0)).astype(float)


def test_grain_varies_the_colour_as_much_as_it_should_and_its_hue_not():
    plain, grainy = picture(grain=0.0)[45:75, 65:95], picture(grain=0.1)[45:75, 65:95]
    ratio = grainy[..., 0] / plain[..., 0]
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert 0.03 < ratio.std() < 0.1
    assert np.abs(grainy[..., 0] / 6 - grainy[..., 1]).max() < 1.5


def test_wet_spots_are_as_white_as_the_lamp():
    dry, wet = picture(grain=0.0), picture(grain=0.0, wet=0.8)
    spot = wet - dry
    assert spot.max() > 60
    assert np.abs(spot[..., 1] - spot[..., 2]).max() <= 2
    assert (spot[:20] == 0).all(), "the table is dry"


def test_each_eye_has_its_own_noise_in_each_channel():
    grey, rng = np.full((80, 80, 3), 0.5, np.float32), np.random.default_rng(0)
    one, other = (expose(grey, 3.0, rng).astype(float) for _ in range(2))
    assert one.std() == pytest.approx(3.0 * (0.3 + np.sqrt(0.5)), rel=0.05)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03
    assert abs(np.corrcoef(one[..., 0].ravel(), one[..., 1].ravel())[0, 1]) < 0.05
    assert expose(np.full((4, 4, 3), 2.0, np.float32), 0.0, rng).max() == 255


def seeds(count, seed=3):
    return np.full(count, seed, np.int32)


def test_noise_is_as_strong_as_it_says_and_at_lattice_points_stronger():
    rng = np.random.default_rng(0)
    at = rng.uniform(-50, 50, (20_000, 3))
    noise = _noise(at, seeds(len(at)))
    assert noise.dtype == np.float32 and abs(noise.mean()) < 0.02 and noise.std() == pytest.approx(0.45, abs=0.02)
    corners = _noise(np.floor(at), seeds(len(at)))
    assert abs(corners.mean()) < 0.02 and corners.std() == pytest.approx(0.84, abs=0.02)
    assert np.abs(corners).max() <= 1.45 and len(np.unique(corners)) > 10_000
    assert _grain(np.float32(2.4e-3 * at), seeds(len(at))).std() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_between_two_lattice_points_noise_is_linear(axis):
    start = np.random.default_rng(1).integers(-9, 9, (200, 3)).astype(float)
    ends = [_noise(start + share * np.eye(3)[axis], seeds(200)) for share in (0.0, 0.25, 0.5, 1.0)]
    np.testing.assert_allclose(ends[1], 0.75 * ends[0] + 0.25 * ends[3], atol=1e-5)
    np.testing.assert_allclose(ends[2], 0.5 * (ends[0] + ends[3]), atol=1e-5)
    assert abs(np.corrcoef(ends[0], ends[3])[0, 1]) < 0.25, "neighbours know nothing of each other"
    assert abs(np.corrcoef(ends[0], _noise(start, seeds(200, 4)))[0, 1]) < 0.25, "nor do surfaces"


def test_in_the_middle_of_a_cell_noise_is_the_mean_of_its_corners():
    corner = np.random.default_rng(2).integers(-9, 9, (50, 3)).astype(float)
    eight = [_noise(corner + [x, y, z], seeds(50)) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    np.testing.assert_allclose(_noise(corner + 0.5, seeds(50)), np.mean(eight, axis=0), atol=1e-5)


def test_noise_of_many_points_is_that_of_each():
    at = np.random.default_rng(0).uniform(-9, 9, (AT_ONCE + 700, 3))
    seed = np.arange(len(at), dtype=np.int32) % 5
    parts = [_noise(at[k : k + 1000], seed[k : k + 1000]) for k in range(0, len(at), 1000)]
    np.testing.assert_array_equal(_noise(at, seed), np.concatenate(parts))


def test_grain_is_coarse_and_half_as_much_fine():
    """Over half a millimetre it is much alike, over 2 mm little."""
    at = np.random.default_rng(0).uniform(-0.1, 0.1, (20_000, 3))

    def alike(over_m):
        pair = [_grain(np.float32(at + [dx, 0, 0]), seeds(len(at))) for dx in (0.0, over_m)]
        return np.corrcoef(*pair)[0, 1]

    assert alike(0.3e-3) == pytest.approx(0.957, abs=0.02)
    assert alike(1.2e-3) == pytest.approx(0.61, abs=0.05)
    assert abs(alike(6e-3)) < 0.03


BALL = """<mujoco><asset><material name="wet" roughness="{grain}" specular=".6" shininess=".5"/>
<material name="dry" specular="0"/></asset><worldbody><geom name="plain" size=".1"/>
<body pos="1 2 3" euler="30 40 50"><geom name="wet" size=".1" material="wet"/>
<geom name="dry" size=".1" material="dry"/>
</body></worldbody></mujoco>"""


def sight(model, name, lit=True, lamp_m=(0.0, 0.0, 1.0), count=1):
    """Points at (0, 0, 0), seen from above; the lamp where one likes."""
    geom = np.full(count, model.geom(name).id if name else -1, np.int32)
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    spread = 0.1 * np.random.default_rng(0).uniform(-1, 1, (count, 3)) * (count > 1)
    return Sight(geom, spread, up, np.array([0, 0, 1.0]), np.array(lamp_m), np.full(count, lit))


def ball(grain=0.0):
    model = mujoco.MjModel.from_xml_string(BALL.format(grain=grain))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_a_smooth_film_of_water_mirrors_as_blinn_and_phong_say(monkeypatch):
    monkeypatch.setattr(appearance, "RIPPLE", 0.0)
    model, data = ball()
    look, dull = Appearance(model), np.full((1, 3), 0.1, np.float32)
    np.testing.assert_allclose(look.apply(data, dull, sight(model, "wet")), 0.7, rtol=1e-5)
    beside = sight(model, "wet", lamp_m=(0.0, 0.0, 1.0))._replace(points_m=np.array([[0.3, 0.0, 0.2]]))
    lamp = np.array([-0.3, 0.0, 0.8]) / np.hypot(0.3, 0.8)
    np.testing.assert_allclose(look.apply(data, dull, beside), 0.1 + 0.6 * (lamp @ [0, 0, 1]) ** 60, rtol=1e-4)
    apart = beside._replace(eye_m=np.array([0.6, 0.0, 1.0]))
    eye = np.array([0.3, 0.0, 0.8]) / np.hypot(0.3, 0.8)
    half = (lamp + eye) / np.linalg.norm(lamp + eye)
    np.testing.assert_allclose(look.apply(data, dull, apart), 0.1 + 0.6 * half[2] ** 60, rtol=1e-4)
    aside = (0.2, 0.0, 1.0)
    half = 0.5 * np.arctan(0.2)
    expected = 0.1 + 0.6 * np.cos(half) ** 60
    np.testing.assert_allclose(look.apply(data, dull, sight(model, "wet", lamp_m=aside)), expected, rtol=1e-4)
    np.testing.assert_allclose(look.apply(data, np.full((1, 3), 0.9, np.float32), sight(model, "wet")), 1.0)
    for other in (sight(model, "wet", lit=False), sight(model, "plain"), sight(model, "")):
        np.testing.assert_array_equal(look.apply(data, dull, other), dull)


def test_an_uneven_film_breaks_the_spot_up():
    model, data = ball()
    found = Appearance(model).apply(data, np.zeros((400, 3), np.float32), sight(model, "wet", count=400))[:, 0]
    assert found.max() > 0.5 and 0.1 < found.mean() < 0.45 and np.median(found) < 0.5


def test_grain_changes_brightness_within_bounds_and_only_of_what_has_some():
    model, data = ball(grain=1.0)
    points = sight(model, "wet", lit=False, count=4000)
    grey = np.full((4000, 3), 0.4, np.float32)
    share = Appearance(model).apply(data, grey, points)[:, 0] / 0.4
    assert share.min() == pytest.approx(0.3) and share.max() == pytest.approx(1.9), "clipped at both ends"
    assert share.mean() == pytest.approx(1.0, abs=0.03) and share.std() == pytest.approx(0.45, abs=0.05)
    for name in ("plain", "dry"):
        np.testing.assert_array_equal(Appearance(model).apply(data, grey, sight(model, name, count=4000)), grey)


def test_grain_turns_with_its_body():
    model, data = ball(grain=0.5)
    points, grey = sight(model, "wet", lit=False, count=300), np.full((300, 3), 0.4, np.float32)
    before = Appearance(model).apply(data, grey, points)
    place, turn = data.geom_xpos[1].copy(), data.geom_xmat[1].reshape(3, 3).copy()
    motion = SE3.from_parts(SO3.exp([0.3, 0.5, -0.7]), [0.1, 0.2, -0.3])
    data.geom_xpos[1] = motion.apply(place)
    data.geom_xmat[1] = (motion.rotation.matrix @ turn).ravel()
    moved = points._replace(points_m=motion.apply(points.points_m))
    np.testing.assert_allclose(Appearance(model).apply(data, grey, moved), before, atol=1e-4)
    assert np.abs(Appearance(model).apply(data, grey, points) - before).mean() > 0.02
