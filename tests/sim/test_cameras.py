"""One eye or two, each with its own lens, place and lamp."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, load_station
from trocar.perception.image import Intrinsics, StereoRig
from trocar.sim.cameras import STEREO_GAINS, CameraRenderer

BARE = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom type="plane" size="1 1 .1"/></worldbody></mujoco>')
T_WORLD_CAMERA = SE3.from_parts(SO3.exp([3.0, 0.1, 0.2]), [0.1, 0.2, 0.5])
LEFT, RIGHT = Intrinsics(24, 16, 30.0, 30.0, 11.5, 7.5), Intrinsics(26, 16, 31.0, 31.0, 12.5, 7.5)
T_LEFT_RIGHT = SE3.from_parts(SO3.exp([0.0, 0.05, 0.0]), [0.06, 0.0, 0.0])
CAMERA = load_station("peg-transfer").cameras["overhead"]


def test_a_pairs_right_eye_stands_beside_the_left_one_under_the_same_lamp():
    pair = replace(CAMERA, model=StereoRig(LEFT, RIGHT, T_LEFT_RIGHT))
    left, right = CameraRenderer(BARE, pair, T_WORLD_CAMERA).lenses
    assert (left.intrinsics, right.intrinsics) == (LEFT, RIGHT)
    assert_allclose(left.T_world_camera.matrix, T_WORLD_CAMERA.matrix)
    assert_allclose(right.T_world_camera.matrix, (T_WORLD_CAMERA @ T_LEFT_RIGHT).matrix)
    lamps = [eye.T_world_camera.apply(eye._lamp_m) for eye in (left, right)]
    assert_allclose(lamps[0], T_WORLD_CAMERA.apply(CAMERA.lamp_m), atol=1e-12)
    assert_allclose(lamps[1], lamps[0], atol=1e-12)


@pytest.mark.parametrize("flaws", [None, SensorFlaws.none()])
def test_an_eye_has_the_cameras_flaws_or_those_it_is_given(flaws):
    (eye,) = CameraRenderer(BARE, replace(CAMERA, model=LEFT), T_WORLD_CAMERA, flaws).lenses
    assert eye.flaws == (flaws or CAMERA.flaws) and CAMERA.flaws != SensorFlaws.none()
    assert (eye.light.ambient, eye.light.gain) == (CAMERA.ambient, CAMERA.gain)


def test_the_right_eye_is_a_little_darker_than_the_left_which_is_as_its_camera():
    left, right = STEREO_GAINS
    assert left == 1.0 and 0.9 < right < 0.99
    assert np.isfinite(STEREO_GAINS).all()
