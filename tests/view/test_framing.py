"""Each browser looks from where its window asks for, until its person looks from elsewhere."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser")
from made_up_replay import made_up_replay
from trocar.view.film import shoot
from trocar.view.framing import TRIES, Framing

REPLAY = made_up_replay(3.0)
FILM = shoot(REPLAY)
INITIAL_M = np.array([5.0, 0.0, 0.0])


class Camera(SimpleNamespace):
    """That of a browser."""

    def __init__(self, width, height):
        super().__init__(image_width=width, image_height=height, position=INITIAL_M, look_at=np.zeros(3))

    @property
    def aspect(self):
        return self.image_width / self.image_height


def aimed(width, height):
    camera, frame = Camera(width, height), Framing(REPLAY, FILM, live=True)
    frame.aim(camera)
    assert not np.allclose(camera.position, INITIAL_M)
    return camera, frame


def test_a_window_whose_size_changes_is_framed_anew_until_its_person_looks_from_elsewhere():
    camera, frame = aimed(1400, 900)
    wide_m = camera.position
    camera.image_width = 936
    frame.aim(camera)
    narrow_m = camera.position
    assert np.linalg.norm(narrow_m - camera.look_at) > np.linalg.norm(wide_m - camera.look_at)
    frame.aim(camera)  # the browser says that it is there
    camera.position = mine = narrow_m + [0.0, 0.01, 0.0]
    for camera.image_width in (936, 1400):
        frame.aim(camera)
    assert camera.position is mine


def test_a_browser_that_takes_the_initial_view_late_is_told_again_but_not_for_ever():
    camera, frame = aimed(936, 900)
    wanted_m = camera.position
    for _ in range(TRIES - 1):
        camera.position = INITIAL_M
        frame.aim(camera)
        assert np.allclose(camera.position, wanted_m)
    camera.position = INITIAL_M
    frame.aim(camera)
    assert camera.position is INITIAL_M
