"""Which arm worked on which goal, from what its script noted, and the goals and ports of a replay."""

from dataclasses import replace

import numpy as np
import pytest

from synthetic import synthetic_trial
from trocar.eval.turns import Turn, turn_at, turns_of
from trocar.geometry import SE3
from trocar.replay import Goal, Solid, painted

TRIAL = synthetic_trial(failures={1: "DROPPED"})
NOTED = [
    {"name": "transfer", "time_s": 2.5, "goal": 1, "turns": {"psm1": [2.0, 2.5], "psm2": [1.0, 3.0]}},
    {"name": "transfer", "time_s": 4.0, "goal": 0, "arm": "psm2", "start_s": 3.5},
]


def test_turns_are_as_noted_and_without_notes_as_the_scores_say():
    noted = turns_of(replace(TRIAL, events=NOTED))
    assert noted == [Turn(1, "psm1", 2.0, 2.5), Turn(1, "psm2", 1.0, 3.0), Turn(0, "psm2", 3.5, 4.0)]
    scored = turns_of(replace(TRIAL, events=[]))
    assert [(turn.goal, turn.arm) for turn in scored] == [(number, None) for number in range(len(TRIAL.scores))]


@pytest.mark.parametrize(("arm", "time_s", "goal"), [("psm1", 2.0, 1), ("psm1", 2.5, None), ("psm2", 3.7, 0)])
def test_a_turn_holds_its_start_and_not_its_end(arm, time_s, goal):
    turn = turn_at(turns_of(replace(TRIAL, events=NOTED)), arm, time_s)
    assert (turn and turn.goal) == goal


def test_a_replay_knows_each_arms_goals_which_were_missed_and_where_its_port_is():
    replay = replace(TRIAL, events=NOTED).replay()
    assert replay.goals == (
        Goal("psm1", 1, 2.0, 2.5, failed=True),
        Goal("psm2", 1, 1.0, 3.0, failed=True),
        Goal("psm2", 0, 3.5, 4.0),
    )
    for arm, T in TRIAL.scenery.T_world_base.items():
        assert np.allclose(replay.ports_m[arm], T.translation_m)
    scored = replace(TRIAL, events=[]).replay().goals
    assert {goal.arm for goal in scored} == set(TRIAL.about["arms"])


def test_solids_are_painted_by_body_or_by_body_and_shape():
    solids = tuple(
        Solid(body, shape, (0.01, 0.01), SE3.identity(), (0.5, 0.5, 0.5, 0.7))
        for body, shape in (("board", "capsule"), ("board", "box"), ("block3", "hull"), ("arm", "box"))
    )
    shown = painted(solids, {"block": (1.0, 0.0, 0.0), "board capsule": (0.0, 1.0, 0.0)})
    assert [solid.rgba[:3] for solid in shown] == [(0.0, 1.0, 0.0), (0.5,) * 3, (1.0, 0.0, 0.0), (0.5,) * 3]
    assert {solid.rgba[3] for solid in shown} == {0.7}
