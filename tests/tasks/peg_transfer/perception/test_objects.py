"""Which transfers a policy is told are done, look by look."""

from types import SimpleNamespace

import numpy as np
import pytest

from trocar.geometry import SE3
from trocar.perception.image import Intrinsics
from trocar.tasks.peg_transfer.goals import GOALS, PegSet
from trocar.tasks.peg_transfer.perception.objects import PegObjects, Seen

GOALS_THERE_AND_BACK = GOALS["unilateral"]


@pytest.fixture
def objects():
    camera = SimpleNamespace(model=Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0))
    cell = SimpleNamespace(
        cameras={"overhead": camera},
        arms={"psm1": None},
        T_world_camera_registered={"overhead": SE3.identity()},
        T_world_fixture={"board": SE3.identity()},
    )
    return PegObjects(cell, GOALS_THERE_AND_BACK, PegSet(), None)


def shown(objects, pegs):
    """Let a look show blocks on these pegs; return the numbers of the transfers that are done."""
    board = PegSet().board
    blocks = {peg: SE3.from_parts(translation_m=board.pegs_m[peg]) for peg in pegs}
    objects.take(Seen(SE3.identity(), blocks, {}))
    return (1 + np.flatnonzero(objects.values[objects.names.index("transfer1.done") :: 15])).tolist()


def test_a_transfer_back_is_not_done_because_its_block_has_not_gone_yet(objects):
    pegs = {goal.source for goal in GOALS_THERE_AND_BACK[:6]}
    assert shown(objects, pegs) == []
    for number, (source, target) in enumerate(GOALS_THERE_AND_BACK, start=1):
        assert shown(objects, pegs - {source}) == list(range(1, number)), "in the jaws"
        pegs = pegs - {source} | {target}
        assert shown(objects, pegs) == list(range(1, number + 1))


def test_what_an_arm_hides_is_not_done(objects):
    pegs = {goal.source for goal in GOALS_THERE_AND_BACK[:6]}
    shown(objects, pegs)
    for source, target in GOALS_THERE_AND_BACK[:6]:
        assert shown(objects, pegs - {source, target}) == []
    assert shown(objects, set()) == []


def test_another_block_on_its_target_does_not_make_a_transfer_done(objects):
    first, second = GOALS_THERE_AND_BACK[:2]
    assert shown(objects, {first.source, second.source}) == []
    assert shown(objects, {first.source, first.target}) == []
