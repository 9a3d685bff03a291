import cv2
import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.perception.color import red_mask
from trocar.tasks.peg_transfer.perception.color_blocks import find_blocks_in_color

HOLES = [(903, 546), (799, 554), (790, 628), (928, 628), (787, 696), (924, 702)]
"""Read off the photograph by eye: pixels in the shadows between peg and wall, by height."""


def photograph(recordings, name: str) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(recordings / "dvrk" / "images" / name)), cv2.COLOR_BGR2RGB)


def test_finds_the_six_blocks_of_the_photograph_and_nothing_else(recordings):
    found = find_blocks_in_color(photograph(recordings, "board_blocks_left.png"))
    assert len(found) == 6
    distance = np.linalg.norm(found[:, None] - np.array(HOLES), axis=-1)
    assert (distance.min(0) < 12).all() and (distance.min(1) < 12).all()


def test_red_is_red_in_light_and_in_shade_but_steel_and_table_are_not():
    rgb = np.array([[205, 60, 14], [120, 39, 13], [61, 19, 6], [23, 23, 17], [160, 160, 165], [12, 14, 12]], np.uint8)
    assert red_mask(rgb).tolist() == [True, True, True, False, False, False]


def test_refuses_what_is_no_picture_of_a_board():
    with pytest.raises(TrocarError, match="no red board"):
        find_blocks_in_color(np.zeros((100, 100, 3), np.uint8))
    with pytest.raises(TrocarError, match="uint8"):
        find_blocks_in_color(np.zeros((100, 100)))
