"""A needle that lies on the phantom is found in one image of all of it."""

from dataclasses import replace

import numpy as np
import pytest

from sewing import sewing_laboratory
from simulated import mild
from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import RgbdImage
from trocar.tasks.suture.lying_needle import find_lying
from trocar.tasks.suture.stand import PHANTOM_M
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures(variant="two-arms", sutures=1)
STATION = TASK.at(mild(TASK.usual_station))
SCENE, ARMS = TASK.scene(np.random.default_rng(0), STATION)
HALF_M = (PHANTOM_M[0] / 2, PHANTOM_M[1] / 2)
CAMERA = "close"
T_CAMERA_FLOOR = STATION.cameras[CAMERA].T_world_camera.inverse() @ SCENE.T_world_circle


def image_of(T_circle_needle):
    """Return an image of the phantom with a needle that lies here."""
    lab, images = sewing_laboratory(TASK, STATION, (SCENE, ARMS)), []

    async def script(cell):
        images.append(await cell.cameras[CAMERA].capture())

    at = SCENE.T_world_circle @ T_circle_needle
    lab.world.data.qpos[lab.task._qpos] = [*at.translation_m, *at.rotation.as_quaternion()]
    assert lab.run(script, 5.0)
    return images[0]


def lying(x_mm, y_mm, turn_rad, up=True):
    turn = SO3.axis("z", turn_rad) @ (SO3.identity() if up else SO3.axis("x", np.pi))
    return SE3.from_parts(turn, [1e-3 * x_mm, 1e-3 * y_mm, SCENE.needle.wire_m / 2])


@pytest.mark.parametrize(
    ("x_mm", "y_mm", "turn_rad", "up"), [(0, 0, 0.3, True), (44, -44, 2.5, False), (-44, 44, -1.0, True)]
)
def test_it_is_found_anywhere_on_the_phantom(x_mm, y_mm, turn_rad, up):
    there = lying(x_mm, y_mm, turn_rad, up)
    found = find_lying(image_of(there), T_CAMERA_FLOOR, HALF_M, SCENE.needle)
    assert found is not None
    np.testing.assert_allclose(1e3 * found.center_m, [x_mm, y_mm], atol=0.2)


def test_nothing_is_found_where_none_lies_on_the_phantom():
    image = image_of(lying(75, 0, 0.0))
    assert find_lying(image, T_CAMERA_FLOOR, HALF_M, SCENE.needle) is None


def test_a_needle_of_which_a_part_is_hidden_is_not_guessed():
    image = image_of(lying(0, 0, 0.0))
    assert isinstance(image, RgbdImage)
    u, _ = project(image.intrinsics, T_CAMERA_FLOOR.translation_m)
    color = image.color.copy()
    color[:, int(u) :] = 0
    assert find_lying(replace(image, color=color), T_CAMERA_FLOOR, HALF_M, SCENE.needle) is None
