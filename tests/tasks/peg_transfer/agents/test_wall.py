"""How thin a wall the jaws are taken to hold."""

from hypothesis import given
from hypothesis import strategies as st

from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.agents.wall import MAX_THINNER_RAD, NOTHING_RAD, WallOpening

SETTINGS = Settings()
LEAST_RAD = SETTINGS.jaw_empty_rad


def learned(*jaw_rad):
    wall = WallOpening(SETTINGS)
    for closing in jaw_rad:
        wall.learn(closing)
    return wall.least_rad


def test_as_long_as_nothing_is_known_a_usual_wall_is_asked_for():
    assert learned() == LEAST_RAD
    assert learned(0.02, 0.05) == LEAST_RAD, "empty jaws tell nothing"
    assert learned(0.32, 0.33) == LEAST_RAD, "nor do jaws that cannot close"
    assert learned(0.14) == LEAST_RAD, "one thin grasp may be at the edge of a wall"


def test_two_thin_grasps_tell_that_walls_are_thin():
    assert learned(0.145, 0.14) < 0.1


def test_the_first_wall_does_not_count_as_lost_when_its_jaws_close_a_little_further():
    assert learned(0.155) < 0.149


def test_an_edge_of_a_thick_wall_is_no_wall():
    assert learned(0.27, 0.27, 0.26) > 0.155


def test_a_wall_held_by_its_rim_right_after_the_first_whole_one_is_none():
    assert learned(0.24, 0.16) > 0.16


def test_edges_do_not_pass_for_usual_walls_because_there_were_some_before():
    assert learned(0.244, 0.201, 0.253, 0.188) > 0.188


@given(st.lists(st.floats(0.0, 0.4), max_size=12))
def test_empty_jaws_hold_no_wall_whatever_was_seen_before(closings):
    assert NOTHING_RAD <= learned(*closings) < SETTINGS.release_rad - MAX_THINNER_RAD
