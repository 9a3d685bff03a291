"""Grain and wet spots of surfaces, and the noise of an eye."""

import mujoco
import numpy as np
import pytest

from trocar.geometry import SE3, SO3
from trocar.perception.image import Intrinsics
from trocar.sim.camera import RayCamera
from trocar.sim.finish import Finish
from trocar.sim.sensor import Light, expose
from trocar.station import SensorFlaws

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
    camera = RayCamera(model, LENS, DOWN, (0.0, 0.0, 0.0), SensorFlaws.none(), light, Finish(model))
    return camera.render_color(data, np.random.default_rng(0)).astype(float)


def test_grain_varies_the_colour_as_much_as_it_should_and_its_hue_not():
    plain, grainy = picture(grain=0.0)[45:75, 65:95], picture(grain=0.1)[45:75, 65:95]
    ratio = grainy[..., 0] / plain[..., 0]
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert 0.03 < ratio.std() < 0.1
    assert np.abs(grainy[..., 0] / 6 - grainy[..., 1]).max() < 1.5


def test_grain_moves_with_its_body():
    still, moved = picture(), picture(shift=(0.019, 0.0))  # by 20 pixels
    assert np.abs(still[45:75, 60:90] - moved[45:75, 80:110]).mean() < 0.05 * still[45:75, 60:90].mean()


def test_without_a_material_a_surface_is_plain():
    assert picture(material="")[50:70, 70:90, 0].std() < 0.3 * picture()[50:70, 70:90, 0].std()


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
