import re
from dataclasses import replace
from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import fk, frames, ik_branches, wrist_depth_m
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
    with_settings,
)
from trocar.tasks.suture.planning.parameters import with_parameters
from trocar.tasks.suture.planning.primitive import jaws_above_m, least_gap_rad, path_samples, tip_poses, turned_to
from trocar.tasks.suture.planning.summary import (
    REMEDY,
    _on_nearest_branch,
    circle_out_of_reach,
    crossing_sutures,
    plan_out_of_reach,
    plan_summary,
    relative_excess,
    tissue_summary,
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


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"base_up_mm": -10}, "the port would lie 10.0 mm under the tissue's surface; move the port$"),
        ({"wall_up_mm": 110}, "the port would lie 10.0 mm below the body wall; move the port or the wall"),
        ({"wall_up_mm": 85, "puller_up_mm": 120}, "the second arm's port would lie 5.0 mm above the body wall; move"),
        ({"wall_up_mm": 40, "wall_thick_mm": 80}, r"deg instrument or needle would be [\d.]+ mm from the body wall, "),
        ({"wall_up_mm": 20, "wall_thick_mm": 90}, r"at all positions instrument or needle would be .* mm in the body"),
        (
            {"puller_azimuth_deg": 225, "puller_sideways_mm": 50, "puller_up_mm": 101},
            "at all positions where the second arm comes to the needle's tip, the instruments would be .* inside each",
        ),
    ],
)
def test_a_body_wall_and_a_second_arm_in_the_way_are_named(settings, sentence):
    joints = dexterity(with_settings(DEFAULT, settings).setup).joints
    assert re.search(sentence, circle_out_of_reach(joints))


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


def grasped(behind, approach, lean):
    return with_parameters(
        DEFAULT.setup,
        {
            "grasp_behind_tip_rad": radians(behind),
            "grasp_approach_rad": radians(approach),
            "grasp_lean_rad": radians(lean),
        },
    )


def test_jaws_under_the_tissue_are_refused_with_how_deep_they_would_be_and_what_to_do():
    setup = grasped(100, -10, 30)
    joints = dexterity(setup, positions=36).joints
    assert not joints.feasible.any()
    depth_mm = -1e3 * jaws_above_m(setup)
    assert depth_mm > 1
    assert circle_out_of_reach(joints) == (
        f"the jaws would be {depth_mm:.2g} mm under the tissue, wherever the suture is; hold the needle farther behind "
        "its tip, or turn the grasp"
    )


def lacking(setup, T_base_tip):
    """Return what the better of all ways to reach these poses (k,) lacks, as a share; the wrist's ball may not sink."""
    arm, T_circle_base = setup.arm, setup.T_base_circle.inverse()
    ball_m = max(arm.instrument.shaft_radius_m, arm.instrument.wrist_radius_m)
    q, real = ik_branches(arm, T_base_tip)
    found = []
    for branch in np.moveaxis(q, 1, 0)[real.all(0)]:
        branch[:, 3] = np.unwrap(branch[:, 3])
        pitch_m = T_circle_base.apply(frames(arm, branch)[:, 5].translation_m)[:, 2]
        sunk = (ball_m - pitch_m).max() / arm.instrument.finger_length_m
        shallow = (arm.safe_depth_m - wrist_depth_m(arm, branch)).max() / arm.safe_depth_m
        for turns in range(-2, 3):
            at = branch + np.array([0, 0, 0, 2 * np.pi * turns, 0, 0])
            outside = np.maximum(arm.lower - at, at - arm.upper) / (arm.upper - arm.lower)
            found.append(max(outside.max(), sunk, shallow))
    return min(found)


def test_the_reason_is_what_lacks_least_of_all_ways_to_hold_the_needle_and_not_of_the_first():
    """On the arm's usual branch of the kinematics it may lack far more."""
    setup = DEFAULT.setup
    joints = dexterity(setup, positions=24).joints
    samples = path_samples(setup)
    poses = turned_to(tip_poses(setup, samples.advance_m, samples.jaws_rad), joints.thetas_rad)
    better = 0
    for row, position in np.argwhere(~joints.feasible):
        nearest = _on_nearest_branch(joints, row, position)
        T_base_tip = setup.T_base_circle @ poses[row, position]
        np.testing.assert_allclose(fk(setup.arm, nearest.q[0, 0]).matrix, T_base_tip.matrix, atol=1e-9)
        least = relative_excess(nearest).max()
        assert least == pytest.approx(lacking(setup, T_base_tip), abs=1e-9)
        better += least < relative_excess(joints)[row, position].max() - 1e-6
    assert better > 3


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


ENTERING = changed(theta_is="entry")


def test_sutures_that_head_for_each_other_cross_and_others_do_not():
    assert crossing(ENTERING, [3, 63], [CCW, CW]) == [(0, 1)]
    assert crossing(ENTERING, [3, 63], [CW, CCW]) == []
    assert crossing(ENTERING, [0, 90, 180, 270], [CCW, CW, CCW, CW]) == []
    assert crossing(replace(ENTERING, circle=Circle(0.040)), [3, 63], [CCW, CW]) == []


@pytest.mark.parametrize("directions", [(CW, CW), (CCW, CW), (CW, CCW), (CCW, CCW)])
def test_bites_round_their_middles_cross_where_their_gap_is_too_small_whatever_their_directions(directions):
    """Two tangents of length L at points of a circle that are an angle apart meet if L / 2 > R tan(angle / 2)."""
    half_m, radius_m = DEFAULT.setup.bite_m / 2, DEFAULT.setup.circle.radius_m
    meet_deg = np.degrees(2 * np.arctan(half_m / radius_m))
    least_deg = np.degrees(least_gap_rad(DEFAULT.setup))
    assert meet_deg < least_deg < meet_deg + 4.0, "the wire's thickness"
    assert crossing(DEFAULT.setup, [0, meet_deg - 0.1], directions) == [(0, 1)]
    assert crossing(DEFAULT.setup, [0, least_deg], directions) == []


@pytest.mark.parametrize(("pairs", "more"), [(3, ""), (5, " and 2 more pairs")])
def test_of_many_sutures_that_cross_three_pairs_are_named_and_how_many_more(pairs, more):
    values = {"crossing_deg": [[10 * k, 10 * k + 5] for k in range(pairs)], "needle_comes_out": True}
    values |= {"mesh_left_mm": 3.0, "mesh_margin_mm": 1.0}
    (warning,) = tissue_warnings(values)
    assert f"from above: 0 and 5, 10 and 15, 20 and 25 deg{more}; ask" in warning


def test_paths_nearer_than_the_wire_meet_though_they_do_not_cross():
    for degrees, meet in ((1.0, True), (3.0, False)):
        apart_m = 2 * ENTERING.circle.radius_m * np.sin(np.radians(degrees) / 2)
        assert bool(apart_m < ENTERING.needle.wire_m) is meet
        assert bool(crossing(ENTERING, [0, degrees], [CW, CCW])) is meet


@pytest.mark.parametrize(("theta_is", "beyond_mm"), [("middle", 5.0), ("middle", 2.0), ("entry", 5.0)])
def test_how_far_bites_stay_from_the_meshs_edge_is_measured_from_entry_and_exit(theta_is, beyond_mm):
    setup = replace(changed(theta_is=theta_is), circle=Circle(0.030, mesh_beyond_m=1e-3 * beyond_mm))
    half = setup.bite_m / (2 if theta_is == "middle" else 1)
    left_mm = 1e3 * (0.030 + 1e-3 * beyond_mm - np.hypot(0.030, half))
    summary = tissue_summary(setup, plan_even(dexterity(setup, positions=36)))
    assert summary["mesh_left_mm"] == pytest.approx(left_mm, abs=1e-6)
    warnings = [line for line in tissue_warnings(summary) if "may not hold the mesh" in line]
    assert bool(warnings) == (left_mm < 1.0)
    if left_mm < 0:
        assert f"reach {-left_mm:.1f} mm over the mesh's edge" in warnings[0]
    elif warnings:
        assert f"come within {left_mm:.1f} mm of its edge, and 1 mm should be left" in warnings[0]


def test_where_sutures_hold_is_told_with_gaps_that_are_even_to_half_a_degree_if_theta_is_there():
    for setup, even in ((DEFAULT.setup, True), (ENTERING, False)):
        map = dexterity(setup)
        plan = plan_even(map)
        found = plan_summary(map, plan)
        for number, (theta, direction) in enumerate(zip(plan.positions_rad, plan.directions, strict=True)):
            suture = Suture(setup, theta, int(direction))
            ends = [np.degrees(np.arctan2(at[1], at[0])) % 360 for at in (suture.entry_m, suture.exit_m)]
            assert [found["entries_deg"][number], found["exits_deg"][number]] == pytest.approx(ends)
            x, y, _ = (suture.entry_m + suture.exit_m) / 2
            assert found["mid_bites_deg"][number] == pytest.approx(np.degrees(np.arctan2(y, x)) % 360)
        gaps = np.array(found["mid_bite_gaps_deg"])
        assert gaps.sum() == pytest.approx(360)
        assert (np.abs(gaps - 90).max() < 0.5) == even


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
    ("fields", "out"),
    [({}, True), ({"pushes": 1}, True), ({"pushes": 0}, False), ({"straight_m": 0.05, "theta_is": "entry"}, False)],
)
def test_the_needle_comes_out_if_its_tip_is_above_the_tissue_at_the_end(fields, out):
    setup = changed(**fields)
    assert bool(Suture(setup, 0.0, CW).needle_path_m[-1, 2] >= 0) is out is setup.comes_out


def test_a_suture_that_never_comes_out_has_no_middle():
    with pytest.raises(InvalidInput, match="has no middle"):
        changed(theta_is="middle", straight_m=0.05)
