"""Waypoints of two arms: they take turns within their limits, and hold the needle where the other one takes it."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from trocar.arms import MOTION_LIMITS, fk
from trocar.lab import load_station
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.planning.segments import JAW_CLOSED_RAD
from trocar.tasks.suture.planning.two_arm_waypoints import TWO_ARM_COLUMNS, two_arm_rows, two_arm_waypoints
from trocar.tasks.suture.planning.two_arms import SecondArm
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures(variant="two-arms", sutures=2)
STATION = TASK.at(load_station(TASK.usual_station))
FIRST, SECOND = (STATION.arm(name) for name in TASK.working_arms(STATION))
PULLER = SecondArm(SECOND.model, SECOND.T_world_base, SECOND.park_q())
EACH = pytest.mark.parametrize("number", range(TASK.sutures))


@cache
def plan():
    return TASK.plan_with(STATION)


@cache
def stitches():
    """Return the waypoints of both arms in each suture."""
    return two_arm_waypoints(TASK.goals(), plan(), FIRST.park_q(), PULLER)


def at(one, segment, which=-1):
    """Return the joints at the end of the segment of this name, the last or another of them."""
    ends = [k for k, (a, b) in enumerate(pairwise([*one.segments, ""])) if a == segment != b]
    return one.q[ends[which]]


def needle(setup, q):
    """Return where the needle is if these joints hold it in the grasp of this setup."""
    return setup.T_base_circle.inverse() @ fk(setup.arm, q) @ grasp_pose(setup).inverse()


@EACH
@pytest.mark.parametrize("arm", [0, 1])
def test_each_arm_stays_within_its_limits_and_goes_on_from_where_it_is(number, arm):
    one = stitches()[number][arm]
    assert one.times_s[0] == 0.0 and (np.diff(one.times_s) > 0).all()
    rates = np.abs(np.diff(one.q, axis=0)) / np.diff(one.times_s)[:, None]
    assert (rates <= MOTION_LIMITS["paper"].velocity).all()


@EACH
def test_while_one_arm_moves_the_other_rests(number):
    moves = []
    for arm, one in enumerate(stitches()[number]):
        changes = np.flatnonzero((np.diff(one.q, axis=0) != 0).any(1))
        moves += [(one.times_s[k], one.times_s[k + 1], arm) for k in changes]
    for (_, end, arm), (start, _, other) in pairwise(sorted(moves)):
        assert arm == other or start > end - 1e-9


def test_both_arms_have_the_needle_at_the_same_place_where_it_changes_hands():
    first, second = stitches()[1]
    handover, given = plan().handovers[0][0], plan().pulls[0].grips[-1].setup
    taking = TASK.goals()[1].setup
    for setup, q in ((taking, at(first, "take")), (given, at(second, "go", 0))):
        np.testing.assert_allclose(needle(setup, q).matrix, handover.T_circle_needle.matrix, atol=1e-6)
    grip = plan().pulls[1].grips[0]
    planned = grip.T_circle_needle(np.array([grip.turn_rad[0]]))[0]
    np.testing.assert_allclose(needle(grip.setup, at(second, "reach", 0)).matrix, planned.matrix, atol=1e-6)


def test_someone_holds_the_needle_unless_tissue_or_stand_do():
    """Jaws close before the others open; the second arm ends with it."""
    first, second = stitches()[1]
    closes, opens = (dict(zip(one.segments, one.times_s, strict=True)) for one in (first, second))
    assert first.times_s[first.segments.index("close")] < second.times_s[second.segments.index("open")]
    assert opens["lift"] == second.times_s[-1] and second.jaw_rad[-1] == JAW_CLOSED_RAD
    assert closes["withdraw"] > second.times_s[second.segments.index("close")]


def test_the_table_names_the_arm_of_each_row():
    table = list(two_arm_rows(["psm1", "psm2"], stitches()))
    assert len(table) == sum(len(one.times_s) for pair in stitches() for one in pair)
    assert {len(row) for row in table} == {len(TWO_ARM_COLUMNS)}
    assert [row[:2] for row in table[:: len(table) - 1]] == [["psm1", "1"], ["psm2", "2"]]
