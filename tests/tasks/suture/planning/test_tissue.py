from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import InvalidInput
from trocar.tasks.suture.planning import CLOCKWISE, COUNTERCLOCKWISE, PRESETS, Circle, Suture, sutures_at
from trocar.tasks.suture.planning.tissue import crossing_sutures

SETUP = PRESETS["default"].setup
CW, CCW = CLOCKWISE, COUNTERCLOCKWISE


def crossing(setup, degrees, directions):
    return crossing_sutures(sutures_at(setup, np.radians(degrees), directions))


def changed(**fields):
    return replace(SETUP, insertion=replace(SETUP.insertion, **fields))


@pytest.mark.parametrize("direction", [CW, CCW])
@pytest.mark.parametrize("fields", [{}, {"theta_is": "middle"}, {"pushes": 0}, {"rotation_rad": 0.2, "pushes": 0}])
def test_path_ends_are_the_entry_and_the_point_in_the_tissue_farthest_from_it(fields, direction):
    suture = Suture(changed(**fields), 0.4, direction)
    path = suture.needle_path_m
    inside = path[path[:, 2] < 1e-9]
    off = np.linalg.norm(inside[:, :2] - suture.entry_m[:2], axis=1)
    start, end = suture.path_ends_m
    np.testing.assert_allclose(start, suture.entry_m[:2], atol=1e-12)
    np.testing.assert_allclose(end, inside[np.argmax(off), :2], atol=3e-5)
    last = path[-1] if suture.exit_m is None else suture.exit_m
    np.testing.assert_allclose(suture.ends_m, [suture.entry_m[:2], last[:2]], atol=1e-9)


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
    ("fields", "out"), [({}, True), ({"pushes": 1}, True), ({"pushes": 0}, False), ({"straight_m": 0.05}, False)]
)
def test_the_needle_comes_out_if_its_tip_is_above_the_tissue_at_the_end(fields, out):
    setup = changed(**fields)
    assert bool(Suture(setup, 0.0, CW).needle_path_m[-1, 2] >= 0) is out is setup.comes_out


def test_a_suture_that_never_comes_out_has_no_middle():
    with pytest.raises(InvalidInput, match="has no middle"):
        changed(theta_is="middle", straight_m=0.05)
