from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.perception.checkerboard.board import Checkerboard
from trocar.perception.checkerboard.detect import find_corners
from trocar.perception.depth import project
from trocar.perception.image import StereoRig
from trocar.sim.checkerboard_cell import CheckerboardCell
from trocar.station import load_station

BOARD = Checkerboard()
TABLE_Z_M, DISTANCE_M = -0.162, 0.232


@pytest.fixture(scope="module")
def station():
    """The pair at half its resolution."""
    station = load_station("raven-pair")
    camera = station.cameras["stereo"]
    rig = StereoRig(camera.model.left.binned(2), camera.model.right.binned(2), camera.model.T_left_right)
    return replace(station, cameras={"stereo": replace(camera, model=rig)})


@pytest.fixture(scope="module")
def cell(station):
    return CheckerboardCell(station, "stereo", BOARD, TABLE_Z_M)


def test_both_eyes_see_the_corners_where_the_lenses_put_them(station, cell):
    camera, rng = station.cameras["stereo"], np.random.default_rng(0)
    T_world_board = cell.hand_pose(rng, DISTANCE_M)
    image = cell.image(T_world_board, rng)
    p_left = (camera.T_world_camera.inverse() @ T_world_board).apply(BOARD.corners_m)
    p_right = camera.model.T_left_right.inverse().apply(p_left)
    for picture, lens, p in ((image.left, image.rig.left, p_left), (image.right, image.rig.right, p_right)):
        found = find_corners(BOARD, picture)
        assert found is not None
        off = found - project(lens, p)
        assert np.sqrt(np.mean(off**2)) < 0.35 and np.abs(off.mean(0)).max() < 0.1


def test_the_board_moves_and_the_same_seed_gives_the_same_picture(cell):
    first, second = (cell.hand_pose(np.random.default_rng(seed), DISTANCE_M) for seed in (1, 2))
    one = cell.image(first, np.random.default_rng(0))
    other = cell.image(second, np.random.default_rng(0))
    again = cell.image(first, np.random.default_rng(0))
    assert one.left.tobytes() == again.left.tobytes() and one.right.tobytes() == again.right.tobytes()
    assert (one.left != other.left).any()


def test_a_hand_holds_the_whole_board_before_both_eyes_above_the_table(station, cell):
    camera, rng = station.cameras["stereo"], np.random.default_rng(3)
    for _ in range(20):
        T_world_board = cell.hand_pose(rng, DISTANCE_M)
        assert T_world_board.apply(BOARD.corners_m)[:, 2].min() > TABLE_Z_M
        p_left = (camera.T_world_camera.inverse() @ T_world_board).apply(BOARD.corners_m)
        p_right = camera.model.T_left_right.inverse().apply(p_left)
        for lens, p in ((camera.model.left, p_left), (camera.model.right, p_right)):
            pixels = project(lens, p)
            assert (pixels > 0).all() and (pixels < (lens.width, lens.height)).all()


def test_a_board_too_large_and_a_camera_with_one_eye_are_refused(station):
    large = CheckerboardCell(station, "stereo", Checkerboard(square_m=0.03), TABLE_Z_M)
    with pytest.raises(TrocarError, match=r"330 x 240 mm is not seen whole by both eyes at 232 mm"):
        large.hand_pose(np.random.default_rng(0), DISTANCE_M)
    with pytest.raises(TrocarError, match="camera 'overhead' of station 'peg-transfer' is not a stereo pair"):
        CheckerboardCell(load_station("peg-transfer"), "overhead", BOARD, TABLE_Z_M)
