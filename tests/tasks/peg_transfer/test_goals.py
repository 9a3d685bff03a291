"""Which block goes where, in which order, and by which arm."""

import numpy as np
import pytest

from trocar.tasks.peg_transfer.goals import GOALS, PAIRS, Transfer, ready
from trocar.tasks.peg_transfer.shapes import Pegboard


def test_two_arms_work_far_apart_and_the_left_one_further_left():
    pegs = Pegboard().pegs_m
    for left, right in PAIRS:
        for a, b in ((left.source, right.source), (left.target, right.target)):
            assert pegs[a, 0] <= pegs[b, 0] and np.linalg.norm(pegs[a] - pegs[b]) > 25e-3


@pytest.mark.parametrize("variant", GOALS)
def test_every_block_goes_over_to_a_free_peg_and_back(variant):
    """Each half of the board is emptied and filled once; a block that did not move is in the way of the next."""
    goals, lies = GOALS[variant], {peg: peg for peg in range(6)}
    for number, (source, target) in enumerate(goals):
        lies[target] = lies.pop(source)
        assert (source < 6) == (number < 6) and (target < 6) != (number < 6) and len(lies) == 6
        if number == 5:
            assert set(lies) == set(range(6, 12))
    assert len(goals) == 12 and lies == {peg: peg for peg in range(6)}


def test_the_transfers_are_the_papers():
    assert GOALS["unilateral"][:6] == GOALS["handover"][:6] == ((1, 7), (0, 6), (3, 8), (2, 9), (5, 11), (4, 10))
    assert GOALS["bilateral"][:6] == ((0, 7), (5, 10), (2, 6), (3, 11), (1, 8), (4, 9))
    assert all(goals[6:] == tuple((target, source) for source, target in goals[:6]) for goals in GOALS.values())


@pytest.mark.parametrize("variant", GOALS)
def test_only_the_way_there_is_ready_before_any_block_has_moved(variant):
    assert ready(GOALS[variant]) == [0, 1, 2, 3, 4, 5]


def test_a_goal_is_ready_once_its_block_has_come_and_its_peg_is_free():
    there, back, onto_its_peg, elsewhere = Transfer(1, 7), Transfer(7, 1), Transfer(2, 1), Transfer(3, 8)
    assert ready([there, back, onto_its_peg, elsewhere]) == [0, 3]
    assert ready([back, onto_its_peg, elsewhere]) == [0, 2]
    assert ready([]) == []
