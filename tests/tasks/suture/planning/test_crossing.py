from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import PRESETS, Circle
from trocar.tasks.suture.planning.crossing import crossing_sutures, tip_paths_m
from trocar.tasks.suture.planning.primitive import bite_m, comes_out, needle_poses, steps, tip_end_m

SETUP = PRESETS["default"].setup
CW, CCW = 1, -1


def crossing(setup, degrees, directions):
    return crossing_sutures(setup, np.radians(degrees), np.array(directions))


def changed(**fields):
    return replace(SETUP, insertion=replace(SETUP.insertion, **fields))


@pytest.mark.parametrize("theta_is", ["entry", "middle"])
def test_paths_are_where_the_needles_tip_goes(theta_is):
    setup = changed(theta_is=theta_is)
    last = steps(setup)[-1]
    turns = np.linspace(0, last.needle_rad[1], 2001)
    poses = needle_poses(setup, np.full(turns.shape, setup.insertion.straight_m), turns)
    tips = poses.apply([0.0, -setup.needle.radius_m, 0.0])
    for row, direction in enumerate((CW, CCW)):
        inside = tips[row][tips[row][:, 2] < 1e-9]
        far = inside[np.argmax(np.abs(inside[:, 1] - tips[row][0, 1]))]
        start, end = tip_paths_m(setup, [0.0], [direction])[0]
        np.testing.assert_allclose(end, far[:2], atol=2e-5)
        assert np.linalg.norm(end - start) == pytest.approx(bite_m(setup))


def test_sutures_that_head_for_each_other_cross_and_others_do_not():
    assert crossing(SETUP, [3, 63], [CCW, CW]) == ((0, 1),)
    assert crossing(SETUP, [3, 63], [CW, CCW]) == ()
    assert crossing(SETUP, [0, 90, 180, 270], [CCW, CW, CCW, CW]) == ()
    assert crossing(replace(SETUP, circle=Circle(0.040)), [3, 63], [CCW, CW]) == ()


def test_paths_nearer_than_the_wire_meet_though_they_do_not_cross():
    for degrees, meet in ((1.0, True), (3.0, False)):
        apart_m = 2 * SETUP.circle.radius_m * np.sin(np.radians(degrees) / 2)
        assert bool(apart_m < SETUP.needle.wire_m) is meet
        assert bool(crossing(SETUP, [0, degrees], [CW, CCW])) is meet


@given(st.floats(0, 360), st.lists(st.floats(0, 359), min_size=2, max_size=6, unique=True), st.integers(0, 63))
def test_turning_or_mirroring_the_plan_changes_no_pair(turn, degrees, bits):
    directions = np.array([1 - 2 * (bits >> i & 1) for i in range(len(degrees))])
    thick = [replace(SETUP, needle=replace(SETUP.needle, wire_m=wire)) for wire in (0.89e-3, 0.91e-3)]
    thin, wide = (set(crossing(setup, degrees, directions)) for setup in thick)
    for found in (
        crossing(SETUP, np.add(degrees, turn), directions),
        crossing(SETUP, np.negative(degrees), -directions),
    ):
        assert thin <= set(found) <= wide


@pytest.mark.parametrize(
    "fields, out", [({}, True), ({"pushes": 1}, True), ({"pushes": 0}, False), ({"straight_m": 0.05}, False)]
)
def test_the_tip_comes_out_if_it_is_above_the_tissue_at_the_end(fields, out):
    setup = changed(**fields)
    last = steps(setup)[-1]
    pose = needle_poses(setup, [setup.insertion.straight_m], [last.needle_rad[1]])
    tip = pose.apply([0.0, -setup.needle.radius_m, 0.0])[0, 0]
    assert bool(tip[2] >= 0) is out is comes_out(setup)
    if not out:
        assert tip_end_m(setup) == pytest.approx(-tip[1])


def test_a_suture_that_never_comes_out_has_no_middle():
    with pytest.raises(TrocarError, match="has no middle"):
        changed(theta_is="middle", straight_m=0.05)
