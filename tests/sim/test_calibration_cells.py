"""Cells in which a person or an arm holds what cameras and cables are calibrated by."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simulated import coarse, ideal_session
from trocar.arms import ARMS, fk
from trocar.calibration.excitation import PSM1_BOX, WIDE_ROWS
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, load_station
from trocar.lab.transmission import Stiff
from trocar.perception.checkerboard import Checkerboard
from trocar.perception.depth import project
from trocar.perception.fiducials import COLORS, SIX_SPHERES
from trocar.perception.image import StereoRig, Window
from trocar.perception.stereo_calibration import find_corners
from trocar.sim.calibration_cells import CheckerboardCell, EmptyTable, FiducialCell, printed, record_motion
from trocar.sim.world import World

BOARD = Checkerboard()
SMALL = Checkerboard(square_m=0.003)
"""Held anywhere it is seen whole, so that a pose is soon found."""
TABLE_Z_M, DISTANCE_M = -0.162, 0.232


@pytest.fixture(scope="module")
def station():
    """The pair at half its resolution."""
    return coarse(load_station("raven-pair"))


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


def test_a_board_too_large_and_a_camera_with_one_eye_are_refused(station, monkeypatch):
    monkeypatch.setattr("trocar.sim.calibration_cells.TRIES", 50)
    large = CheckerboardCell(station, "stereo", Checkerboard(square_m=0.03), TABLE_Z_M)
    with pytest.raises(TrocarError, match=r"330 x 240 mm is not seen whole by both lenses at 232 mm"):
        large.hand_pose(np.random.default_rng(0), DISTANCE_M)
    with pytest.raises(TrocarError, match="camera 'overhead' of station 'peg-transfer' is not a stereo pair"):
        CheckerboardCell(load_station("peg-transfer"), "overhead", BOARD, TABLE_Z_M)


def rim_of(board):
    """Return the corners of a board's plate."""
    width, height = np.array(board.size_m) / 2 + board.square_m
    return np.array([[x * width, y * height, 0.0] for x in (-1, 1) for y in (-1, 1)])


@pytest.fixture(scope="module")
def held(station):
    """Poses of the small board before the left eye, its corners with their rim in the world, and both eyes' pixels."""
    small, camera = CheckerboardCell(station, "stereo", SMALL, TABLE_Z_M), station.cameras["stereo"]
    rng, corners, found = np.random.default_rng(5), rim_of(SMALL), []
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
    rng = np.random.default_rng(0)
    lowest = [low.hand_pose(rng, DISTANCE_M).apply(rim_of(SMALL))[:, 2].min() for _ in range(60)]
    assert min(lowest) > table_z_m + 2e-3, "the board is as thick as that"
    assert min(lowest) < table_z_m + 5e-3


def test_the_board_is_a_white_plate_with_a_rim_and_its_black_squares_lie_on_it(cell):
    model = cell._world.model
    body = model.body("checkerboard").id
    plate, *black = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    (width, height), square = BOARD.size_m, BOARD.square_m
    assert_allclose(2 * model.geom_size[plate], [width + 2 * square, height + 2 * square, 2e-3])
    front = model.geom_pos[plate, 2] - model.geom_size[plate, 2]  # the camera looks along z
    middles, is_black = BOARD.squares_m
    assert_allclose(model.geom_pos[black, :2], middles[is_black, :2], atol=1e-12)
    assert_allclose(2 * model.geom_size[black, :2], square)
    assert_allclose(model.geom_pos[black, 2] + model.geom_size[black, 2], front)  # the print ends on the plate
    assert_allclose(model.geom_pos[black, 2] - model.geom_size[black, 2], 0.0, atol=1e-12)
    assert 0 < front < 5e-6, "so thin that no edge moves"
    white, dark = model.geom_rgba[plate], model.geom_rgba[black]
    assert np.ptp(white[:3]) == 0.0 and np.ptp(dark[:, :3]) == 0.0 and (model.geom_rgba[:, 3] == 1.0).all()
    assert white[0] < 0.4, "too dull to mirror the lamp"
    assert (white[0] > 6 * dark[:, 0]).all()
    table = model.geom("table")
    assert_allclose(table.pos, [0, 0, TABLE_Z_M])
    assert np.ptp(table.rgba[:3]) == 0.0 and dark[0, 0] < table.rgba[0] < white[0]


@pytest.fixture
def day():
    """A session whose camera has few pixels."""
    day = ideal_session()
    camera = day.station.cameras["overhead"]
    cameras = {"overhead": replace(camera, model=camera.model.binned(8))}
    return replace(day, station=replace(day.station, cameras=cameras))


def test_the_table_is_black_and_below_the_work_and_stops_nothing():
    table = World({}, {}, EmptyTable()).model.geom("table")
    assert table.pos[:2].tolist() == [0.0, 0.0] and -0.12 < table.pos[2] < -0.04
    assert table.rgba[3] == 1.0 and table.rgba[:3].min() > 0.0 and table.rgba[:3].max() < 0.08
    assert table.contype[0] == table.conaffinity[0] == 0


@pytest.mark.parametrize("flaws", [None, SensorFlaws.none()])
def test_its_camera_has_the_stations_flaws_or_others(day, flaws):
    rng = np.random.default_rng(0)
    cell = FiducialCell(day, "psm1", "overhead", SIX_SPHERES, rng, flaws)
    assert cell._camera.lenses[0].flaws == (flaws or day.station.cameras["overhead"].flaws)
    assert cell.fixture != SIX_SPHERES, "what was printed"
    q = day.station.arms["psm1"].park_q()
    image = cell.image(q, Window((5, 7), (20, 30)), rng)
    assert image.depth_m.shape == (30, 20)


def test_a_camera_without_depth_is_refused(day):
    lens = day.station.cameras["overhead"].model
    rig = StereoRig(lens, lens, SE3.identity())
    pair = replace(day.station, cameras={"overhead": replace(day.station.cameras["overhead"], model=rig)})
    with pytest.raises(TrocarError, match="has no depth"):
        FiducialCell(replace(day, station=pair), "psm1", "overhead", SIX_SPHERES, np.random.default_rng(0))


def test_a_printed_sphere_lies_beside_its_place_by_the_printers_scatter():
    rough = replace(SIX_SPHERES, print_sd_m=0.3e-3)
    rng = np.random.default_rng(0)
    off = np.array([printed(rough, rng).centers_m - rough.centers_m for _ in range(200)])
    assert_allclose(off.std(axis=(0, 1)), 0.3e-3, rtol=0.06)
    assert np.abs(off.mean(axis=0)).max() < 0.1e-3
    assert_allclose(printed(rough, rng).radii_m, rough.radii_m)


@pytest.mark.parametrize("name", ["psm-classic", "raven2-left"])
def test_spheres_hang_on_shaft_and_jaws_and_rods_lead_to_those_of_the_jaws(name):
    arm, fixture = ARMS[name], SIX_SPHERES
    world = World({"x": arm}, {"x": SE3.identity()}, fixtures={"x": fixture})
    model = world.model
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper)
    world.place_arm("x", q, 0.0)
    assert_allclose(world.data.geom_xpos[world.geoms("x_sphere")], fixture.base_centers_m(arm, q), atol=1e-9)
    for number, sphere in enumerate(fixture.spheres):
        geom = model.geom(f"x_sphere{number}")
        assert geom.size[0] == sphere.radius_m
        assert_allclose(geom.rgba, [*COLORS[sphere.color], 1], rtol=1e-6)
    rods = world.geoms("x_rod")
    assert len(rods) == 4
    for rod, center in zip(rods, fixture.frame_centers_m(arm)[~fixture.on_shaft], strict=True):
        assert model.body(model.geom_bodyid[rod]).name == "x_link6"
        radius, half = model.geom_size[rod, :2]
        assert radius == fixture.arm_radius_m
        assert 2 * half == pytest.approx(np.linalg.norm(center - np.array(fixture.hub_m)))
        assert_allclose(model.geom_pos[rod], (center + fixture.hub_m) / 2, atol=1e-12)
        assert model.geom_rgba[rod][:3].max() < 0.05 and model.geom_rgba[rod][3] == 1, "black"
    assert (model.geom_contype[rods] > 0).all(), "rays miss what nothing collides with"


# Recordings of an arm's motion, as noisy fiducials show it.

SD = np.array([1e-3, 2e-3, 3e-4, 4e-3, 5e-3, 6e-3])


class Scattered(Stiff):
    """Joints that follow their commands, and fiducials that scatter."""

    @property
    def measurement_sd(self):
        return SD


@pytest.mark.parametrize(("samples", "wide", "rows"), [(40, False, 40), (30, True, 30), (None, True, WIDE_ROWS)])
def test_two_swings_take_up_the_slack_before_so_many_samples_at_their_times(samples, wide, rows):
    found = record_motion(ideal_session(), "psm1", np.random.default_rng(0), PSM1_BOX, samples, wide=wide)
    assert found.valid.tolist() == [False] * 2 + [True] * rows
    assert_allclose(found.t_s, 0.8 * np.arange(1, rows + 3))
    assert_allclose(found.q_phy, found.q_cmd, atol=1e-9)
    assert (found.q_cmd[2:] >= PSM1_BOX.lower - 1e-9).all() and (found.q_cmd[2:] <= PSM1_BOX.upper + 1e-9).all()


def test_joints_are_seen_in_the_base_that_was_found_though_they_leave_the_commands_range():
    day = ideal_session()
    beside = SE3.from_parts(SO3.exp([0.01, -0.02, 0.03]), [2e-3, 1e-3, -3e-3])
    found = replace(day, T_world_base_registered=day.T_world_base | {"psm1": day.T_world_base["psm1"] @ beside})
    rows = record_motion(found, "psm1", np.random.default_rng(0), PSM1_BOX, 20)
    arm = day.station.arm("psm1").model
    told, seen = fk(arm, rows.q_cmd), beside @ fk(arm, rows.q_phy)
    assert_allclose(seen.matrix, told.matrix, atol=1e-9)


def test_fiducials_scatter_as_much_as_they_should():
    day = ideal_session()
    day = replace(day, transmissions={"psm1": Scattered()})
    rows = record_motion(day, "psm1", np.random.default_rng(0), PSM1_BOX, 1000)
    assert_allclose((rows.q_phy - rows.q_cmd)[2:].std(axis=0), SD, rtol=0.1)
