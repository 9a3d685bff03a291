"""The twelve transfers of each variant, as a board with six blocks on its left half allows them."""

import pytest

from trocar.tasks.peg_transfer.goals import GOALS
from trocar.tasks.peg_transfer.shapes import Pegboard


@pytest.mark.parametrize("variant", GOALS)
def test_every_block_goes_over_to_a_free_peg_and_back(variant):
    goals, pegs = GOALS[variant], len(Pegboard().pegs_m)
    left, right = set(range(pegs // 2)), set(range(pegs // 2, pegs))
    occupied = set(left)
    for number, (source, target) in enumerate(goals):
        assert source in occupied and target not in occupied, f"transfer {number}"
        assert {source} <= (left if number < 6 else right) and {target} <= (right if number < 6 else left)
        occupied = occupied - {source} | {target}
        if number == 5:
            assert occupied == right
    assert len(goals) == 12 and occupied == left
