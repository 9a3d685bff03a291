"""What an agent may ask of its cell."""

import numpy as np
import pytest
import trio

from driven import ARM, PAPER
from trocar.cell import SEAT, Cell, GoalOffer
from trocar.errors import InvalidInput, UnknownName
from trocar.geometry import SE3

GOALS = [GoalOffer("a", f"takes block {k}", np.zeros((2, 3))) for k in range(3)]


def cell(**assistants):
    base = {"a": SE3.identity()}
    return Cell(None, {}, {"a": ARM}, {"a": PAPER}, base, {}, {}, None, None, assistants)


class Last:
    """A person who chooses the last goal."""

    async def choose(self, goals):
        await trio.sleep(0)
        return len(goals) - 1


def test_a_script_takes_its_first_goal_at_once_unless_a_person_chooses_another():
    alone = cell().choose(GOALS)
    with pytest.raises(StopIteration) as ended:  # it never yields, so that no other script runs in between
        alone.send(None)
    assert ended.value.value == 0
    assert trio.run(cell(**{SEAT: Last()}).choose, GOALS) == 2


@pytest.mark.parametrize("assistants", [{}, {SEAT: Last()}])
def test_goals_that_nobody_can_pursue_are_refused(assistants):
    with pytest.raises(InvalidInput, match="a choice of goals offers none; offer at least one"):
        trio.run(cell(**assistants).choose, [])
    with pytest.raises(UnknownName, match="the arm of a goal 'b' is unknown; choose one of a"):
        trio.run(cell(**assistants).choose, [*GOALS, GoalOffer("b", "takes block 3", np.zeros((2, 3)))])
