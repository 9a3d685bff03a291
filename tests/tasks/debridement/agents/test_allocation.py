"""Which arm gets which fragment."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from trocar.geometry import SE3
from trocar.tasks.debridement.agents.allocation import FULL_LOOKS, PATIENCE_S, Allocation, Failure
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.perception.fragments import SeenFragment

TABLE = SE3.from_parts(translation_m=[-0.0745, 0.0, -0.162])
RECEPTACLE = SE3.from_parts(translation_m=[-0.0745, 0.004, -0.162])
APART_M = 0.028


def seen(x, y, height_m=0.004):
    p = np.array([x, y, TABLE.translation_m[2] + height_m])
    return SeenFragment(p, np.array([0.012, 0.009]), 0.0, 0.004, 500)


@pytest.fixture
def allocation():
    made = Allocation(SimpleNamespace(progress=lambda: None), Workspace(), TABLE, RECEPTACLE, 6)
    made.busy = {"left", "right"}
    return made


def places(fragments):
    return [tuple(f.p_world_m[:2].tolist()) for f in fragments]


OUTER_LEFT, MIDDLE, OUTER_RIGHT = (-0.03, -0.07), (-0.075, -0.09), (-0.12, -0.06)
ALL = [seen(*place) for place in (MIDDLE, OUTER_LEFT, OUTER_RIGHT)]


def test_a_tip_is_over_the_receptacle_if_it_is_far_enough_from_each_wall(allocation):
    x, y, _ = RECEPTACLE.translation_m
    long, wide = 0.5 * np.array(Workspace().receptacle.size_m) - 0.018
    for sign in (-1, 1):
        assert allocation.over_receptacle(np.array([x + 0.99 * sign * long, y - 0.99 * sign * wide, -0.1]), 0.018)
        assert not allocation.over_receptacle(np.array([x + 1.01 * sign * long, y, -0.1]), 0.018)
        assert not allocation.over_receptacle(np.array([x, y + 1.01 * sign * wide, -0.1]), 0.018)


def test_each_arm_takes_the_outermost_on_its_side_first(allocation):
    assert places(allocation.choices("left", 1, ALL, APART_M, 0.0)) == [OUTER_LEFT, MIDDLE, OUTER_RIGHT]
    assert places(allocation.choices("right", -1, ALL, APART_M, 0.0)) == [OUTER_RIGHT, MIDDLE, OUTER_LEFT]


def test_arms_that_think_ahead_do_not_leave_two_that_are_too_close_together_to_the_end(allocation):
    pair = (-0.07, -0.07), (-0.08, -0.075)
    four = [seen(*place) for place in (OUTER_LEFT, *pair, OUTER_RIGHT)]
    for arm, side, outer, one in (("left", 1, OUTER_LEFT, pair[0]), ("right", -1, OUTER_RIGHT, pair[1])):
        assert places(allocation.choices(arm, side, four, APART_M, 0.0))[0] == one
        assert places(allocation.choices(arm, side, four, APART_M, 0.0, ahead=False))[0] == outer, "as the paper has it"
    allocation.busy = {"left"}
    assert places(allocation.choices("left", 1, four, APART_M, 0.0))[0] == OUTER_LEFT, "nobody is in its way"


def test_nothing_near_the_other_arms_fragment_is_given_until_it_carries_that_away(allocation):
    near = seen(MIDDLE[0] + 0.02, MIDDLE[1])
    allocation.claim("right", ALL[0].p_world_m)
    assert places(allocation.choices("left", 1, [*ALL, near], APART_M, 0.0)) == [OUTER_LEFT, OUTER_RIGHT]
    allocation.carry("right")
    assert len(allocation.choices("left", 1, [*ALL, near], APART_M, 0.0)) == 4
    assert "right" in allocation.claimed  # it still has a fragment that counts


def test_a_place_where_one_failed_comes_last_for_a_while(allocation):
    allocation.failures.append(Failure("left", ALL[1].p_world_m, 10.0, blocked=False))
    assert places(allocation.choices("left", 1, ALL, APART_M, 11.0))[-1] == OUTER_LEFT
    assert places(allocation.choices("left", 1, ALL, APART_M, 10.0 + PATIENCE_S + 1.0))[0] == OUTER_LEFT


def test_where_an_arm_found_no_way_is_left_to_the_other_one_if_that_goes_on(allocation):
    allocation.failures.append(Failure("left", ALL[1].p_world_m, 10.0, blocked=True))
    assert OUTER_LEFT not in places(allocation.choices("left", 1, ALL, APART_M, 11.0))
    assert OUTER_LEFT in places(allocation.choices("right", -1, ALL, APART_M, 11.0))
    allocation.busy = {"left"}
    assert places(allocation.choices("left", 1, ALL, APART_M, 11.0))[-1] == OUTER_LEFT


def test_what_lies_in_the_receptacle_or_hangs_in_the_air_is_not_loose(allocation):
    inside, held = seen(-0.08, 0.01), seen(-0.05, -0.08, height_m=0.03)
    assert places(allocation.loose([*ALL, inside, held])) == places(ALL)


def test_parts_of_one_fragment_count_once(allocation):
    """A finger before a fragment divides it: a trial would go on for one that is not there."""
    whole, part = seen(-0.128, -0.071), replace(seen(-0.1334, -0.0715), area_px=200)
    beside = replace(seen(-0.128, -0.063), area_px=200)
    assert allocation.loose([part, whole, beside]) == [whole, beside]


def test_what_was_pushed_a_little_out_of_the_region_is_loose_still(allocation):
    pushed = seen(-0.145, -0.08)
    assert places(allocation.loose([*ALL, pushed])) == [*places(ALL), (-0.145, -0.08)]


def test_a_receptacle_is_full_if_several_stand_out_of_it_for_a_while(allocation):
    high = [seen(x, 0.004, height_m=Workspace().receptacle.height_m) for x in (-0.1, -0.075, -0.05)]
    beside = [
        seen(x, y, Workspace().receptacle.height_m) for x, y in ((-0.08, -0.055), (-0.005, 0.004), (-0.145, 0.004))
    ]
    assert not any(allocation.full([*ALL, *beside], []) for _ in range(2 * FULL_LOOKS)), "beside it"
    for off_m in (-0.004, 0.004):
        others = [seen(*f.p_world_m[:2], Workspace().receptacle.height_m + off_m) for f in high]
        assert not any(allocation.full([*ALL, *others], []) for _ in range(2 * FULL_LOOKS)), "in it, or carried over it"
    assert not any(allocation.full([*ALL, high[0]], []) for _ in range(2 * FULL_LOOKS)), "one lies on another"
    assert [allocation.full([*ALL, *high], []) for _ in range(FULL_LOOKS)] == [False] * (FULL_LOOKS - 1) + [True]
    assert not allocation.full([*ALL, *high], [high[0].p_world_m]), "one of three is in jaws"
