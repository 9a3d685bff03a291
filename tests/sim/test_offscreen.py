"""Pictures of a trial for people, from its replay."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated import ideal_laboratory, standing, trial_of
from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws
from trocar.perception.depth import project
from trocar.replay import Replay, Solid, ToolPath, Viewpoint
from trocar.sim.offscreen import FILLED, HEIGHTS, WIDTH, OffscreenCamera, _floor_m, framed, handled, look_at, overview
from trocar.sim.ray_camera import RayCamera

VIEW = Viewpoint((0.13, -0.46, 0.33))
FRAME_M = np.array([[x, y, z] for x in (-0.07, 0.07) for y in (-0.05, 0.05) for z in (0.0, 0.05)])
"""The board, and as much above it as blocks are carried."""
SCALE = 0.4


@pytest.fixture(scope="module")
def lab():
    lab = ideal_laboratory(standing(0), standing(4, (1e-3, 0.0), 0.3))

    async def script(cell):
        await cell.clock.sleep(0.1)

    assert lab.run(script, 1.0)
    return lab


@pytest.fixture(scope="module")
def replay(lab):
    """The laboratory's replay, in which the first block has jumped by 5 cm at the end."""
    replay = trial_of(lab).replay()
    poses = replay.T_world_body["block0"].matrix.copy()
    poses[-1, 0, 3] += 0.05
    return replace(replay, T_world_body={**replay.T_world_body, "block0": SE3(poses)})


def changed(first, second):
    """Return how many pixels are of another colour."""
    return int((np.abs(first.astype(int) - second).max(axis=-1) > 30).sum())


def test_a_picture_shows_the_moment_it_was_asked_for_and_leaves_the_replay_alone(replay):
    before = {name: T.matrix.copy() for name, T in replay.T_world_body.items()}
    photographer = OffscreenCamera(replay, VIEW, scale=SCALE, frame_m=FRAME_M)
    first, end, again = (photographer.picture(t) for t in (0.0, replay.times_s[-1], 0.0))
    assert first.dtype == np.uint8 and first.shape[1:] == (WIDTH * SCALE, 3)
    assert first.std() > 10
    assert np.array_equal(first, again)
    assert changed(first, end) > 100
    assert np.array_equal(first, photographer.picture(0.004)), "the nearest moment"
    for name, T in replay.T_world_body.items():
        assert np.array_equal(T.matrix, before[name])


def test_every_solid_is_where_the_simulator_had_it(lab, replay):
    """Depth, ray by ray, in the world that was simulated and in the one that is drawn: table and planes apart."""
    T_world_camera, lens = framed(np.array(VIEW.eye_m), FRAME_M, SCALE / 2)
    photographer = OffscreenCamera(replay, VIEW, scale=SCALE / 2, frame_m=FRAME_M)
    photographer.picture(0.0)
    mujoco.mj_forward(lab.world.model, lab.world.data)
    seen = []
    for model, data in ((lab.world.model, lab.world.data), (photographer._model, photographer._data)):
        camera = RayCamera(model, lens, T_world_camera, (0.12, 0.0, 0.0), SensorFlaws.none())
        depth, geom, _ = camera.render_exact(data)
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        seen.append(np.where(plane | (geom < 0), np.nan, depth))
    simulated, drawn = seen
    assert np.isfinite(simulated).mean() > 0.2
    solid = np.isfinite(simulated) & np.isfinite(drawn)
    assert (np.isfinite(simulated) == np.isfinite(drawn)).mean() > 0.999
    assert np.quantile(np.abs(simulated - drawn)[solid], 0.999) < 20e-6


def test_bodies_may_have_other_colours_in_pictures(replay):
    plain = OffscreenCamera(replay, VIEW, scale=SCALE, frame_m=FRAME_M).picture(0.0)
    blue = OffscreenCamera(replay, VIEW, {"block": (0.0, 0.2, 1.0)}, SCALE, FRAME_M).picture(0.0)
    assert changed(plain, blue) > 100
    assert (
        (blue[..., 2].astype(int) - blue[..., 0] > 60).sum()
        > 50
        > (plain[..., 2].astype(int) - plain[..., 0] > 60).sum()
    )


def test_without_a_viewpoint_all_that_moved_is_in_the_picture(replay):
    first, end = (OffscreenCamera(replay, scale=SCALE).picture(t) for t in (0.0, replay.times_s[-1]))
    assert first.std() > 5
    assert changed(first, end) > 20


ON_ITS_SIDE = SE3.from_parts(SO3.axis("x", np.pi / 2), [0.0, 0.0, 0.3])
RGBA = (0.5, 0.5, 0.5, 1.0)


def still(solids=(), tools=None, bodies=None, times=2):
    """A replay of solids on the world that does not move."""
    poses = {"world": SE3.identity(), **(bodies or {})}
    return Replay("still", np.arange(times) * 0.01, tuple(solids), poses, tools or {}, {}, (), ())


def solid(shape, size_m, T, body="world", vertices_m=None):
    return Solid(body, shape, size_m, T, RGBA, np.zeros((0, 3)) if vertices_m is None else vertices_m)


@pytest.mark.parametrize(
    ("shape", "size_m", "lowest_m"),
    [
        ("box", (0.03, 0.07, 0.04), 0.23),
        ("sphere", (0.05,), 0.25),
        ("cylinder", (0.02, 0.1), 0.2),
        ("capsule", (0.02, 0.1), 0.2),
        ("box", (0.03, 0.04, 0.07), 0.26),  # on its side its y is upright
    ],
)
def test_the_table_is_below_the_lowest_solid_that_stands_still(shape, size_m, lowest_m):
    high = solid("sphere", (0.01,), SE3.from_parts(translation_m=[0, 0, 0.9]))
    moving = {"block": SE3.from_parts(None, np.zeros((2, 3)))}
    falling = solid("sphere", (5.0,), SE3.identity(), "block")
    other_side = SE3.from_parts(SO3.axis("x", -np.pi / 2), [0.0, 0.0, 0.3])
    for T in (ON_ITS_SIDE, other_side):
        assert _floor_m(still([high, solid(shape, size_m, T), falling], bodies=moving)) == pytest.approx(lowest_m)


def test_the_table_is_below_a_hulls_lowest_corner_or_without_solids_below_the_tips():
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, -0.2, 0], [0, 0, 0.3]])
    assert _floor_m(still([solid("hull", (), ON_ITS_SIDE, vertices_m=corners)])) == pytest.approx(0.1)
    tool = ToolPath(np.zeros((2, 3)), np.array([[0, 0, 0.4], [0, 0, 0.3]]))
    assert _floor_m(still(tools={"a": tool})) == pytest.approx(0.3)
    assert _floor_m(still()) == 0.0


def path(start, end):
    return ToolPath(np.array([start, end], dtype=float), np.array([start, end], dtype=float))


def test_what_is_handled_is_where_tips_and_loose_bodies_were_with_some_room():
    loose = {
        "block": SE3.from_parts(None, np.array([[0.1, 0, 0.5], [0.1, 0.2, 0.5]])),
        "psm1": SE3.from_parts(None, np.ones((2, 3))),
    }
    tools = {"psm1": path((0.02, 0.06, 0.5), (0.05, 0.06, 0.5)), "psm2": path((9, 9, 9), (9, 9, 9.01))}  # psm2 rests
    points = handled(still(tools=tools, bodies=loose))
    moved = points[:4].tolist()
    assert sorted(moved) == [[0.02, 0.06, 0.5], [0.05, 0.06, 0.5], [0.1, 0, 0.5], [0.1, 0.2, 0.5]]
    np.testing.assert_allclose(points[4:], [[0.01, -0.01, 0.48], [0.11, 0.21, 0.52]], atol=1e-9)
    resting = handled(still(tools={"psm2": tools["psm2"]}))
    assert resting[:2].tolist() == [[9, 9, 9], [9, 9, 9.01]], "without any motion, where the tips are"
    fixed = {"post": SE3.from_parts(translation_m=[1, 2, 3])}
    assert handled(still(bodies=fixed))[:2].tolist() == [[0, 0, 0], [1, 2, 3]], "without tips, where the bodies are"


def test_without_a_view_the_eye_is_in_front_and_above_at_thrice_the_width():
    points = np.array([[0.0, 0, 0], [0.3, 0.4, 0.0], [0.1, 0.1, 0.0]])
    eye = np.array(overview(points).eye_m) - [0.15, 0.2, 0.0]
    assert np.linalg.norm(eye) == pytest.approx(3.2 * 0.5, rel=0.02)
    assert eye[1] < -abs(eye[0]) < 0 < eye[2] and eye[0] > 0
    near = np.array(overview(0.01 * points).eye_m)
    assert np.linalg.norm(near) == pytest.approx(3.2 * 0.06, rel=0.05), "never too near"


def test_solids_stand_in_a_picture_as_they_stood_in_their_colours():
    """A red ball to the left, a hull to the right that moves: seen from the front over the table."""
    corners = 0.02 * np.array([[-1, -1, -1], [1, -1, -1], [0, 1, -1], [0, 0, 1.0]])
    moving = SE3.from_parts(None, np.array([[0.05, 0, 0.02], [0.05, 0, 0.08]]))
    solids = [
        Solid("world", "sphere", (0.02,), SE3.from_parts(translation_m=[-0.05, 0, 0.02]), (1, 0, 0, 1)),
        Solid("tetra", "hull", (), SE3.identity(), (0, 1, 0, 1), corners),
        Solid("nowhere", "sphere", (1.0,), SE3.identity(), (0, 0, 1, 1)),
    ]
    frame = np.array([[-0.08, 0, 0.0], [0.08, 0, 0.1]])
    photographer = OffscreenCamera(
        still(solids, bodies={"tetra": moving}), Viewpoint((0, -0.5, 0.1)), scale=0.25, frame_m=frame
    )
    middles = []
    for time_s in (0.0, 0.01):
        picture = photographer.picture(time_s).astype(int)
        red, green, blue = (picture[..., k] - picture[..., [(k + 1) % 3, (k + 2) % 3]].max(-1) > 60 for k in range(3))
        assert not blue.any() and red.sum() > 50 < green.sum()
        middles.append([np.argwhere(mask).mean(0) for mask in (red, green)])
    (red, low), (again, up) = middles
    assert red == pytest.approx(again) and red[1] < 80 < low[1] == pytest.approx(up[1], abs=1.5) and up[0] < low[0] - 20
    assert red[1] + low[1] == pytest.approx(159, abs=3), "one as far to the left as the other to the right"


EYE_M = np.array([0.13, -0.46, 0.33])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.06, 0.15]))
def test_points_reach_from_edge_to_edge_and_none_is_outside(seed, size_m):
    points = np.random.default_rng(seed).uniform(-size_m, size_m, (12, 3))
    T_world_camera, lens = framed(EYE_M, points)
    uv = np.array([project(lens, p) for p in T_world_camera.inverse().apply(points)])
    low, high = uv.min(axis=0), uv.max(axis=0)
    assert (low >= 0).all() and high[0] <= lens.width - 1 and high[1] <= lens.height - 1
    filled = (high - low) / [lens.width, lens.height]
    assert filled.max() == pytest.approx(FILLED, abs=0.02)
    assert (low + high) / 2 == pytest.approx([(lens.width - 1) / 2, (lens.height - 1) / 2], abs=0.1)
    assert HEIGHTS[0] - 0.01 <= lens.height / lens.width <= HEIGHTS[1] + 0.01


def test_the_picture_is_level_and_smaller_at_a_smaller_scale():
    points = np.array([[-0.05, -0.02, 0.0], [0.05, 0.02, 0.03]])
    (T_world_camera, large), (_, small) = framed(EYE_M, points), framed(EYE_M, points, 0.5)
    assert T_world_camera.rotation.matrix[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert small.width * 2 == large.width and small.fx * 2 == pytest.approx(large.fx)


@pytest.mark.parametrize("points", [[[0.0, 0.0, 0.0], [0.2, -0.9, 0.6]], np.zeros((2, 3))])
def test_what_lies_behind_the_eye_or_all_in_one_place_does_no_harm(points):
    T_world_camera, lens = framed(EYE_M, np.array(points))
    assert np.isfinite(T_world_camera.matrix).all() and 0 < lens.fx < np.inf and lens.width == 640


@pytest.mark.parametrize(("tall_m", "height_px"), [(0.02, 358), (0.065, 416), (0.3, 480)])
def test_a_picture_is_640_pixels_wide_and_as_high_as_what_is_in_it_within_bounds(tall_m, height_px):
    points = np.array([[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.0, tall_m], [0.0, 0.0, 0.0]])
    _, lens = framed(np.array([0.0, -5.0, tall_m / 2]), points)  # from so far away that all is at one distance
    assert (lens.width, lens.height) == (640, pytest.approx(height_px, abs=1))
    assert (lens.cx, lens.cy) == (319.5, (lens.height - 1) / 2) and lens.fx == lens.fy
    wide, tall = lens.fx * 0.1 / 5, lens.fy * tall_m / 5
    assert max(wide / 640, tall / lens.height) == pytest.approx(0.94, rel=0.01)


def test_a_level_camera_looks_at_its_target_with_the_world_upright():
    eye, target = np.array([0.3, -0.4, 0.5]), np.array([0.1, 0.2, 0.1])
    T = look_at(eye, target)
    seen = T.inverse().apply(target)
    assert seen == pytest.approx([0, 0, np.linalg.norm(target - eye)])
    assert T.inverse().apply(target + [0, 0, 0.1])[1] < 0, "up in the world is up in the picture"
    right = T.apply([1.0, 0, 0]) - eye
    assert right[2] == pytest.approx(0.0) and np.cross(right, [0, 0, 1])[:2] @ (eye - target)[:2] > 0
    assert T.translation_m == pytest.approx(eye)


def test_what_is_too_near_counts_as_two_centimetres_away():
    beside = np.array([[0.0, 1.0, 0.0], [0.01, 1.0, 0.0], [0.001, 0.001, 0.0]])
    _, lens = framed(np.zeros(3) + [0, 0, 1e-9], beside)
    assert lens.fx > 500, "a point a millimetre before the lens does not fill the picture"
