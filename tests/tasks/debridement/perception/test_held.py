"""Whether jaws hold something red, in both eyes."""

import numpy as np
import pytest
from stereo_scenes import STATION

from trocar.geometry import SE3, SO3
from trocar.perception.image import StereoImage
from trocar.tasks.debridement.perception.stereo_view import StereoView

VIEW = StereoView()
ARM = STATION.arms["left"].model
JAW_RAD = 0.5
T_WORLD_TIP = SE3.from_parts(SO3.axis("z", 0.4), (-0.06, -0.06, -0.11))


def holding(stage, image=None, jaw_rad=JAW_RAD):
    return VIEW.holding(stage.show().image if image is None else image, stage.T_world_camera, ARM, T_WORLD_TIP, jaw_rad)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.002, 0, -0.004), (0, 0.003, -0.006)])
def test_a_fragment_between_the_fingers_is_held(stage, shift):
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    stage.move("fragment0", T_WORLD_TIP.translation_m + shift)
    assert holding(stage)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_fragment_that_hangs_from_the_end_of_a_finger_is_seen(stage, side):
    wide_rad = 2.0
    stage.put("left", T_WORLD_TIP, wide_rad)
    for number in range(1, 6):
        stage.move(f"fragment{number}", [0.3, 0.3, 0.0])
    stage.move("fragment0", T_WORLD_TIP.apply(np.array([0.0215 * side, -0.002, -0.0045])))
    assert holding(stage, jaw_rad=wide_rad)


def test_empty_jaws_hold_nothing(stage):
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    for number in range(6):
        stage.move(f"fragment{number}", [0.3, 0.3, 0.0])
    assert not holding(stage)


@pytest.mark.parametrize("aside", [(0, 0), (0.01, 0.0), (0.0, -0.01), (0.0, -0.04)])
def test_what_lies_on_the_table_below_is_not_held(stage, aside):
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    below = T_WORLD_TIP.translation_m[:2] + aside
    for number in range(1, 6):
        stage.move(f"fragment{number}", [0.3, 0.3, 0.0])
    stage.move("fragment0", [*below, -0.158])
    assert not holding(stage)


def test_dark_eyes_see_nothing_held(stage):
    image = stage.show().image
    dark = np.zeros_like(image.left)
    assert not holding(stage, StereoImage(dark, dark, image.rig))
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    stage.move("fragment0", T_WORLD_TIP.translation_m)
    image = stage.show().image
    assert not holding(stage, StereoImage(image.left, dark, image.rig))
