import re
from dataclasses import replace
from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import InvalidInput
from trocar.tasks.suture.planning import (
    CLOCKWISE,
    COUNTERCLOCKWISE,
    PRESETS,
    Circle,
    Suture,
    base_beside,
    dexterity,
    plan_even,
    suture_joints,
    sutures_at,
)
from trocar.tasks.suture.planning.setup import with_parameters
from trocar.tasks.suture.planning.summary import (
    REMEDY,
    circle_out_of_reach,
    crossing_sutures,
    plan_out_of_reach,
    tissue_warnings,
    unreachable_arcs,
)

CW, CCW = CLOCKWISE, COUNTERCLOCKWISE
DEFAULT = PRESETS["default"]


def sutures(plan):
    return sutures_at(DEFAULT.setup, plan.positions_rad, plan.directions)


def wide(radius_m=0.090):
    return replace(DEFAULT.setup, circle=Circle(radius_m))


def test_a_circle_within_reach_has_no_sentence():
    joints = dexterity(DEFAULT.setup).joints
    assert unreachable_arcs(joints) == []
    assert circle_out_of_reach(joints) == ""
    assert plan_out_of_reach(sutures(plan_even(dexterity(DEFAULT.setup)))) == ""


@pytest.mark.parametrize("turn_deg", [0, 170, 300])
def test_the_arcs_are_exactly_where_neither_direction_is_feasible(turn_deg):
    """Also where they go over theta = 0: the base is turned about the circle's axis."""
    setup = with_parameters(wide(), {"base_azimuth_rad": radians(225.0 + turn_deg)})
    joints = dexterity(setup).joints
    (arc,) = unreachable_arcs(joints)
    within = (np.degrees(joints.thetas_rad) - arc["from"]) % 360 <= (arc["to"] - arc["from"]) % 360 + 1e-9
    assert np.array_equal(within, ~joints.feasible.any(0))


def test_the_sentence_names_positions_joint_value_excess_and_limit():
    setup = wide()
    joints = dexterity(setup).joints
    sentence = circle_out_of_reach(joints)
    found = re.search(
        r"at (\d+) to (\d+) deg joint 'pitch' would reach (\S+) deg, (\S+) deg beyond .* (\S+) deg;", sentence
    )
    first, last, value, excess, limit = map(float, found.groups())
    assert value == pytest.approx(limit - excess, abs=0.11)
    arc = suture_joints(setup, np.radians(np.arange(first, last + 1)))
    easier = arc.excess[..., 1].min(0)
    assert np.degrees(easier.max()) == pytest.approx(excess, abs=0.06), "the worst position of the arc, its better way"
    assert "\n" not in sentence


def without_solutions(*places):
    """Return the joints of the default setup as if the arm had none at these positions, which are in degrees."""
    joints = dexterity(DEFAULT.setup).joints
    q = joints.q.copy()
    q[:, list(places)] = np.nan
    return replace(joints, q=q)


@pytest.mark.parametrize(("arcs", "more"), [(3, ""), (5, "; and at 2 more arcs")])
def test_the_longest_arcs_are_named_first_and_of_many_only_how_many_more(arcs, more):
    """They begin at 10, 40, ... deg, each one degree longer than the last."""
    joints = without_solutions(*(10 + 30 * k + place for k in range(arcs) for place in range(k + 1)))
    found = [(round(arc["from"]), round(arc["to"])) for arc in unreachable_arcs(joints)]
    assert found == [(10 + 30 * k, 10 + 31 * k) for k in reversed(range(arcs))]
    sentence = circle_out_of_reach(joints)
    assert re.findall(r"at (\d+) (?:to \d+ )?deg", sentence) == [str(first) for first, _ in found[:3]]
    assert sentence.endswith(f"as planned{more}; {REMEDY}")


def test_depth_is_named_where_it_is_the_depth_that_is_lacking():
    setup = replace(DEFAULT.setup, T_world_base=base_beside(0.0, 0.010, 0.030))
    joints = dexterity(setup).joints
    sentence = circle_out_of_reach(joints)
    found = re.search(r"all positions the wrist would be (\S+) mm beyond the remote centre, (\S+) mm less", sentence)
    depth, lacking = map(float, found.groups())
    assert depth + lacking == pytest.approx(1e3 * setup.arm.safe_depth_m, abs=0.11)


def test_no_configuration_at_all_is_said_so():
    assert "at 10 to 12 deg no configuration" in circle_out_of_reach(without_solutions(10, 11, 12))


def test_a_plan_names_its_own_sutures_where_another_direction_would_do():
    found = dexterity(DEFAULT.setup)
    plan = plan_even(found)
    sentence = plan_out_of_reach(sutures(replace(plan, directions=-plan.directions)))
    rows = [[1, -1].index(direction) for direction in -plan.directions]
    blocked = [
        f"at {np.degrees(theta):.4g} deg"
        for theta, row in zip(plan.positions_rad, rows, strict=True)
        if not suture_joints(DEFAULT.setup, theta).feasible[row, 0]
    ]
    assert blocked
    assert all(part in sentence for part in blocked)
    assert sentence.count("beyond its limit") == len(blocked)


# Crossing in the tissue.


def crossing(setup, degrees, directions):
    return crossing_sutures(sutures_at(setup, np.radians(degrees), directions))


def changed(**fields):
    return replace(DEFAULT.setup, insertion=replace(DEFAULT.setup.insertion, **fields))


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
    assert crossing(DEFAULT.setup, [3, 63], [CCW, CW]) == [(0, 1)]
    assert crossing(DEFAULT.setup, [3, 63], [CW, CCW]) == []
    assert crossing(DEFAULT.setup, [0, 90, 180, 270], [CCW, CW, CCW, CW]) == []
    assert crossing(replace(DEFAULT.setup, circle=Circle(0.040)), [3, 63], [CCW, CW]) == []


@pytest.mark.parametrize(("pairs", "more"), [(3, ""), (5, " and 2 more pairs")])
def test_of_many_sutures_that_cross_three_pairs_are_named_and_how_many_more(pairs, more):
    values = {"crossing_deg": [[10 * k, 10 * k + 5] for k in range(pairs)], "needle_comes_out": True}
    (warning,) = tissue_warnings(values)
    assert f"from above: 0 and 5, 10 and 15, 20 and 25 deg{more}; ask" in warning


def test_paths_nearer_than_the_wire_meet_though_they_do_not_cross():
    for degrees, meet in ((1.0, True), (3.0, False)):
        apart_m = 2 * DEFAULT.setup.circle.radius_m * np.sin(np.radians(degrees) / 2)
        assert bool(apart_m < DEFAULT.setup.needle.wire_m) is meet
        assert bool(crossing(DEFAULT.setup, [0, degrees], [CW, CCW])) is meet


@given(st.floats(0, 360), st.lists(st.floats(0, 359), min_size=2, max_size=6, unique=True), st.integers(0, 63))
def test_turning_or_mirroring_the_plan_changes_no_pair(turn, degrees, bits):
    directions = np.array([1 - 2 * (bits >> i & 1) for i in range(len(degrees))])
    thick = [replace(DEFAULT.setup, needle=replace(DEFAULT.setup.needle, wire_m=wire)) for wire in (0.89e-3, 0.91e-3)]
    thin, wide = (set(crossing(setup, degrees, directions)) for setup in thick)
    for found in (
        crossing(DEFAULT.setup, np.add(degrees, turn), directions),
        crossing(DEFAULT.setup, np.negative(degrees), -directions),
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
