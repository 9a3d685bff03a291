from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.lab import load_station
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project
from trocar.perception.image import StereoRig
from trocar.perception.stereo_calibration import find_corners
from trocar.sim.calibration_cells import CheckerboardCell

BOARD = Checkerboard()
SMALL = Checkerboard(square_m=0.003)
"""Held anywhere it is seen whole, so that a pose is soon found."""
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
    for _ in range(5):
        T_world_board = cell.hand_pose(rng, DISTANCE_M)
        assert T_world_board.apply(BOARD.corners_m)[:, 2].min() > TABLE_Z_M
        p_left = (camera.T_world_camera.inverse() @ T_world_board).apply(BOARD.corners_m)
        p_right = camera.model.T_left_right.inverse().apply(p_left)
        for lens, p in ((camera.model.left, p_left), (camera.model.right, p_right)):
            pixels = project(lens, p)
            assert (pixels > 0).all() and (pixels < (lens.width, lens.height)).all()


def test_a_board_too_large_and_a_camera_with_one_eye_are_refused(station, monkeypatch):
    monkeypatch.setattr("trocar.sim.calibration_cells.TRIES", 50)
    large = CheckerboardCell(station, "stereo", Checkerboard(square_m=0.03), TABLE_Z_M)
    with pytest.raises(TrocarError, match=r"330 x 240 mm is not seen whole by both lenses at 232 mm"):
        large.hand_pose(np.random.default_rng(0), DISTANCE_M)
    with pytest.raises(TrocarError, match="camera 'overhead' of station 'peg-transfer' is not a stereo pair"):
        CheckerboardCell(load_station("peg-transfer"), "overhead", BOARD, TABLE_Z_M)


@pytest.fixture(scope="module")
def held(station):
    """Poses of the small board before the left eye, its corners with their rim in the world, and both eyes' pixels."""
    small, camera = CheckerboardCell(station, "stereo", SMALL, TABLE_Z_M), station.cameras["stereo"]
    rng = np.random.default_rng(5)
    (width, height), rim = SMALL.size_m, SMALL.square_m
    corners = np.array([[x * (width / 2 + rim), y * (height / 2 + rim), 0.0] for x in (-1, 1) for y in (-1, 1)])
    found = []
    for _ in range(150):
        T_world_board = small.hand_pose(rng, DISTANCE_M)
        T_left_board = camera.T_world_camera.inverse() @ T_world_board
        p_left = T_left_board.apply(corners)
        p_right = camera.model.T_left_right.inverse().apply(p_left)
        pixels = project(camera.model.left, p_left), project(camera.model.right, p_right)
        found.append((T_left_board, T_world_board.apply(corners), pixels))
    return found


def test_a_hand_turns_the_board_within_reach_of_the_wrist_and_holds_it_about_where_the_work_is(held):
    turns = np.array([T.rotation.log() for T, _, _ in held])
    most = np.abs(turns).max(axis=0)
    assert (most <= [0.6, 0.6, 0.8]).all() and (most > [0.55, 0.55, 0.7]).all()
    assert (turns.min(axis=0) < -0.4).all() and (turns.max(axis=0) > 0.4).all(), "to both sides"
    depth = np.array([T.translation_m[2] for T, _, _ in held]) / DISTANCE_M
    assert 0.8 <= depth.min() < 0.83 and 1.07 < depth.max() <= 1.1


def test_its_white_rim_is_seen_by_both_eyes_too(station, held):
    rig = station.cameras["stereo"].model
    left, right = (np.array([pixels[eye] for _, _, pixels in held]).reshape(-1, 2) for eye in (0, 1))
    for pixels, lens in ((left, rig.left), (right, rig.right)):
        assert (pixels >= 0).all() and (pixels <= (lens.width - 1, lens.height - 1)).all()
    for axis, size in enumerate((rig.left.width, rig.left.height)):
        both = np.concatenate([left, right])[:, axis]
        assert both.min() < 0.02 * size and both.max() > 0.98 * size, "as near to the edge as it may be"


def test_low_over_the_table_no_board_is_held_through_it(station, held):
    heights = [p[:, 2].min() for _, p, _ in held]
    table_z_m = float(np.median(heights)) - 2e-3
    low = CheckerboardCell(station, "stereo", SMALL, table_z_m)
    (width, height), rim = SMALL.size_m, SMALL.square_m
    corners = np.array([[x * (width / 2 + rim), y * (height / 2 + rim), 0.0] for x in (-1, 1) for y in (-1, 1)])
    rng = np.random.default_rng(0)
    lowest = [low.hand_pose(rng, DISTANCE_M).apply(corners)[:, 2].min() for _ in range(60)]
    assert min(lowest) > table_z_m + 2e-3, "the board is as thick as that"
    assert min(lowest) < table_z_m + 5e-3


def test_the_board_is_a_white_plate_with_a_rim_and_its_black_squares_lie_on_it(cell):
    model = cell._world.model
    body = model.body("checkerboard").id
    plate, *black = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    (width, height), square = BOARD.size_m, BOARD.square_m
    np.testing.assert_allclose(2 * model.geom_size[plate], [width + 2 * square, height + 2 * square, 2e-3])
    front = model.geom_pos[plate, 2] - model.geom_size[plate, 2]  # the camera looks along z
    middles, is_black = BOARD.squares_m
    np.testing.assert_allclose(model.geom_pos[black, :2], middles[is_black, :2], atol=1e-12)
    np.testing.assert_allclose(2 * model.geom_size[black, :2], square)
    np.testing.assert_allclose(
        model.geom_pos[black, 2] + model.geom_size[black, 2], front
    )  # the print ends on the plate
    np.testing.assert_allclose(model.geom_pos[black, 2] - model.geom_size[black, 2], 0.0, atol=1e-12)
    assert 0 < front < 5e-6, "so thin that no edge moves"
    white, dark = model.geom_rgba[plate], model.geom_rgba[black]
    assert np.ptp(white[:3]) == 0.0 and np.ptp(dark[:, :3]) == 0.0 and (model.geom_rgba[:, 3] == 1.0).all()
    assert white[0] < 0.4, "too dull to mirror the lamp"
    assert (white[0] > 6 * dark[:, 0]).all()
    table = model.geom("table")
    np.testing.assert_allclose(table.pos, [0, 0, TABLE_Z_M])
    assert np.ptp(table.rgba[:3]) == 0.0 and dark[0, 0] < table.rgba[0] < white[0]
