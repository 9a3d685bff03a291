import re
from dataclasses import replace
from math import radians

import numpy as np
import pytest

from trocar.tasks.suture.planning import PRESETS, Circle, base_beside, dexterity, suture_joints, sutures_at
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.reach import circle_out_of_reach, plan_out_of_reach, unreachable_arcs

DEFAULT = PRESETS["default"]


def sutures(plan):
    return sutures_at(DEFAULT.setup, plan.positions_rad, plan.directions)


def wide(radius_m=0.090):
    return replace(DEFAULT.setup, circle=Circle(radius_m))


def test_a_circle_within_reach_has_no_sentence():
    joints = dexterity(DEFAULT.setup).joints
    assert unreachable_arcs(joints) == ()
    assert circle_out_of_reach(joints) == ""
    assert plan_out_of_reach(sutures(plan_even(dexterity(DEFAULT.setup)))) == ""


@pytest.mark.parametrize("turn_deg", [0, 170, 300])
def test_the_arcs_are_exactly_where_neither_direction_is_feasible(turn_deg):
    """Also where they go over theta = 0: the base is turned about the circle's axis."""
    setup = replace(
        wide(),
        T_world_base=base_beside(
            radians(225.0 + turn_deg), 0.050, 0.100, tilt_rad=radians(40.0), spin_rad=radians(-135.0)
        ),
    )
    joints = dexterity(setup).joints
    (arc,) = unreachable_arcs(joints)
    within = (joints.thetas_rad - arc.from_rad) % (2 * np.pi) <= (arc.to_rad - arc.from_rad) % (2 * np.pi) + 1e-9
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


def test_depth_is_named_where_it_is_the_depth_that_is_lacking():
    setup = replace(DEFAULT.setup, T_world_base=base_beside(0.0, 0.010, 0.030))
    joints = dexterity(setup).joints
    sentence = circle_out_of_reach(joints)
    found = re.search(r"all positions the wrist would be (\S+) mm beyond the remote centre, (\S+) mm less", sentence)
    depth, lacking = map(float, found.groups())
    assert depth + lacking == pytest.approx(1e3 * setup.arm.safe_depth_m, abs=0.11)


def test_no_configuration_at_all_is_said_so():
    joints = dexterity(DEFAULT.setup).joints
    q = joints.q.copy()
    q[:, 10:13] = np.nan
    assert "at 10 to 12 deg no configuration" in circle_out_of_reach(replace(joints, q=q))


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
