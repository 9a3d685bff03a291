"""Whatever is handled is in the picture, upright, and no arm hides another."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay, still_replay
from trocar.geometry import SE3, SO3
from trocar.replay import Replay, Solid, ToolPath
from trocar.view.film import shoot
from trocar.view.viewpoint import ASPECT, FIELD_RAD, MARGINS, MIN_RADIUS_M, fixed_corners, viewpoint

ABOVE, BELOW, BESIDE = MARGINS


def in_picture(view, points_m):
    """Return where points (n, 3) are in the picture: (n, 2) within -1 and 1 from left to right and bottom to top."""
    ahead = (view.target_m - view.eye_m) / np.linalg.norm(view.target_m - view.eye_m)
    up = np.cross(view.right, ahead)
    from_eye = points_m - view.eye_m
    depth = from_eye @ ahead
    assert (depth > 0).all()
    flat = np.stack([from_eye @ view.right / ASPECT, from_eye @ up], -1) / depth[:, None]
    return flat / np.tan(FIELD_RAD / 2)


def turned(replay, T):
    """Return the same trial somewhere else."""
    tools = {a: ToolPath(T.apply(t.p_world_planned_m), T.apply(t.p_world_driven_m)) for a, t in replay.tools.items()}
    poses = {body: T @ pose for body, pose in replay.T_world_body.items()}
    return Replay(replay.title, replay.times_s, replay.solids, poses, tools)


MADE_UP = made_up_replay(6.0)


@settings(max_examples=15, deadline=None)
@given(angle=st.floats(-3.1, 3.1), x=st.floats(-2, 2), z=st.floats(-1, 1))
def test_tips_and_objects_are_in_the_picture_wherever_the_trial_is(angle, x, z):
    replay = turned(MADE_UP, SE3.from_parts(SO3.axis("z", angle), [x, -x, z]))
    film = shoot(replay)
    view = viewpoint(replay, film)
    tips = np.concatenate([tool.p_world_driven_m for tool in replay.tools.values()])
    blocks = film.position_m[[name.startswith("block") for name in film.bodies]].reshape(-1, 3)
    places = in_picture(view, np.concatenate([tips, blocks]))
    assert (np.abs(places[:, 0]) <= 1 - BESIDE + 1e-6).all()
    assert (places[:, 1] <= 1 - ABOVE + 1e-6).all()
    assert (places[:, 1] >= -1 + BELOW - 1e-6).all()
    assert np.ptp(places, axis=0).max() > 0.6  # and fill a good part of it


@settings(max_examples=15, deadline=None)
@given(angle=st.floats(-3.1, 3.1))
def test_both_arms_stand_side_by_side_in_the_picture(angle):
    replay = turned(MADE_UP, SE3.from_parts(SO3.axis("z", angle), np.zeros(3)))
    view = viewpoint(replay, shoot(replay))
    tips = np.array([tool.p_world_driven_m.mean(0) for tool in replay.tools.values()])
    apart = tips[1] - tips[0]
    assert abs(apart @ view.right) > 0.85 * np.linalg.norm(apart)


def test_the_camera_is_above_level_with_the_horizon_at_negative_y_and_looks_at_the_middle():
    view = viewpoint(MADE_UP, shoot(MADE_UP))
    assert_allclose(view.front, [0, -1, 0], atol=1e-12)  # of two equal sides
    assert view.eye_m[2] > view.centre_m[2]
    assert view.right[2] == 0
    assert_allclose(np.cross(view.right, [0, 0, 1]), view.front, atol=1e-12)
    assert_allclose(in_picture(view, view.target_m[None]), 0.0, atol=1e-12)
    ahead = (view.target_m - view.eye_m) / np.linalg.norm(view.target_m - view.eye_m)
    assert_allclose((view.centre_m - view.target_m) @ ahead, 0.0, atol=1e-12)  # one turns about it


@pytest.mark.parametrize("lean", [-1.0, 1.0])
def test_it_stands_on_the_side_that_instruments_lean_away_from(lean):
    rods, poses, n = [], {}, 5
    for x in (-0.1, 0.1):
        shaft = SE3.from_parts(SO3.axis("x", -lean), [x, 0.2 * np.sin(lean), 0.2])
        poses[f"rod{x}"] = SE3(np.tile(shaft.matrix, (n, 1, 1)))
        rods.append(Solid(f"rod{x}", "capsule", (0.004, 0.2), SE3.identity(), (0.5, 0.5, 0.5, 1.0)))
    tips = {f"rod{x}": ToolPath(*2 * [np.tile([x, 0.0, 0.0], (n, 1))]) for x in (-0.1, 0.1)}
    replay = Replay("rods", 0.01 * np.arange(n), tuple(rods), poses, tips)
    assert np.sign(viewpoint(replay, shoot(replay)).front[1]) == -lean


@pytest.mark.parametrize("replay", [made_up_replay(2.0, ("psm1",), 0), made_up_replay(2.0, (), 2), still_replay()])
def test_one_arm_none_or_nothing_that_moves_can_be_looked_at(replay):
    film = shoot(replay)
    view = viewpoint(replay, film)
    assert np.isfinite(view.eye_m).all()
    assert view.radius_m >= MIN_RADIUS_M


def test_an_arm_that_is_parked_elsewhere_is_in_the_picture_but_not_in_its_middle():
    n = len(MADE_UP.times_s)
    parked = np.tile([-0.12, 0.06, 0.10], (n, 1))
    replay = replace(MADE_UP, tools={**MADE_UP.tools, "psm2": ToolPath(parked, parked)})
    film = shoot(replay)
    view = viewpoint(replay, film)
    assert np.abs(in_picture(view, parked[:1])).max() < 0.95
    together = viewpoint(MADE_UP, shoot(MADE_UP))
    far, near = (float(np.linalg.norm(v.eye_m - v.target_m)) for v in (view, together))
    assert near < far < 2.5 * near


ON_BOARD = replace(MADE_UP, solids=tuple(s for s in MADE_UP.solids if s.body != "world" or s.size_m[0] < 0.2))
"""Without the table, which is larger than a picture."""


def between_margins(view, points_m):
    """Return where points (n, 3) are in the picture, -1 to 1 between its margins: (n, 2)."""
    places = in_picture(view, points_m)
    return places / np.column_stack([0 * places[:, 0] + 1 - BESIDE, 1 - np.where(places[:, 1] < 0, BELOW, ABOVE)])


def test_the_picture_is_as_tight_as_its_margins_allow():
    replay = replace(ON_BOARD, ports_m={"psm1": np.array([0.08, 0.0, 0.07]), "psm2": np.array([-0.08, 0.0, 0.07])})
    film = shoot(replay)
    view = viewpoint(replay, film)
    tips = np.concatenate([tool.p_world_driven_m for tool in replay.tools.values()])
    everything = np.concatenate([tips, fixed_corners(replay, film), list(replay.ports_m.values())])
    assert np.abs(between_margins(view, everything)).max() == pytest.approx(1.0, abs=1e-6)


def test_ports_are_in_the_picture_unless_they_are_too_far_away_for_it():
    film = shoot(ON_BOARD)
    without = viewpoint(replace(ON_BOARD, ports_m={}), film)
    for height, shown in ((0.07, True), (0.3, False)):
        ports = {arm: np.array([0.6 * port[0], port[1], height]) for arm, port in MADE_UP.ports_m.items()}
        view = viewpoint(replace(ON_BOARD, ports_m=ports), film)
        assert (np.abs(between_margins(view, np.array([*ports.values()]))) <= 1 + 1e-6).all() == shown
        assert np.allclose(view.eye_m, without.eye_m) != shown


def test_beside_a_panel_the_camera_is_further_away():
    film = shoot(MADE_UP)
    wide, narrow = (viewpoint(MADE_UP, film, aspect) for aspect in (1.5, 0.7))
    assert np.linalg.norm(narrow.eye_m - narrow.target_m) > 1.1 * np.linalg.norm(wide.eye_m - wide.target_m)


def test_a_path_that_is_partly_unknown_does_not_matter():
    path = MADE_UP.tools["psm1"]
    gaps = np.where(np.arange(len(MADE_UP.times_s))[:, None] < 100, np.nan, path.p_world_driven_m)
    tools = {**MADE_UP.tools, "psm1": ToolPath(gaps, gaps)}
    replay = Replay("gaps", MADE_UP.times_s, MADE_UP.solids, MADE_UP.T_world_body, tools)
    assert np.isfinite(viewpoint(replay, shoot(replay)).eye_m).all()
