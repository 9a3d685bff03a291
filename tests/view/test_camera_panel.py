"""Images beside a scene, with what was found in them."""

import numpy as np

from trocar.view.camera_panel import FOUND, with_outlines


def test_an_outline_is_drawn_where_it_is_and_one_behind_the_camera_is_not():
    grey = np.full((200, 400, 3), 90, np.uint8)
    square = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 60.0], [20.0, 60.0]])
    drawn = with_outlines(grey, {"a": square, "behind": np.full((4, 2), np.nan)})
    for x, y in ((20, 40), (40, 20), (40, 60)):
        assert (drawn[y, x] == FOUND).all()
    assert (drawn[40, 40] == 90).all() and (grey == 90).all()
    assert (with_outlines(grey, {"behind": np.full((4, 2), np.nan)}) == 90).all()


def test_a_small_image_is_enlarged_with_what_is_drawn_and_a_name_stays_in_it():
    grey = np.full((80, 100, 3), 90, np.uint8)
    drawn = with_outlines(grey, {"needle": np.array([[60.0, 20.0], [90.0, 20.0], [90.0, 60.0], [60.0, 60.0]])})
    assert drawn.shape == (320, 400, 3)
    assert (drawn[160, 362] == FOUND).all() and (drawn[160, 300] == 90).all()
    named = (drawn == FOUND).all(-1)
    assert named[:, :230].any() and not named[:, 380:].any()
