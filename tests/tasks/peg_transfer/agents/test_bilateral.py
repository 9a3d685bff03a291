"""Two arms that do transfers at once; `test_faults.py` has what goes wrong."""

import pytest

from simulated import ideal_laboratory, standing
from trocar.errors import TrocarError
from trocar.tasks.peg_transfer.agents.two_arms import Bilateral
from trocar.tasks.peg_transfer.goals import GOALS
from two_armed import SETTINGS, Chooser, briefed, distance_of_arms_m, named, played

FIRST = GOALS["bilateral"][:2]
LEFT, RIGHT = FIRST


@pytest.fixture(scope="module")
def clean():
    return played("bilateral", FIRST)


def test_two_blocks_are_moved_at_once(clean):
    lab, in_time, scores = clean
    assert in_time and [score.succeeded for score in scores] == [True, True]
    first, second = scores
    assert max(first.start_s, second.start_s) < min(first.end_s, second.end_s)
    moving = {arm: [s for s in lab.log.spans if s.arm == arm and s.name == "motion"] for arm in ("psm1", "psm2")}
    assert any(a.start_s < b.end_s and b.start_s < a.end_s for a in moving["psm1"] for b in moving["psm2"])


def test_each_arm_takes_the_blocks_of_its_side(clean):
    lab, _, _ = clean
    truth = lab.truth()
    held = {arm: set(by.any(axis=0).nonzero()[0].tolist()) for arm, by in truth.held_by.items()}
    assert held == {"psm2": {LEFT.source}, "psm1": {RIGHT.source}}


def test_the_log_says_which_arm_had_which_transfer(clean):
    lab, _, scores = clean
    noted = {event["goal"]: event["turns"] for event in named(lab, "transfer")}
    assert {goal: list(turns) for goal, turns in noted.items()} == {0: ["psm2"], 1: ["psm1"]}
    assert [noted[0]["psm2"], noted[1]["psm1"]] == [[score.start_s, score.end_s] for score in scores]


def test_the_arms_keep_their_margin_and_the_guard_has_nothing_to_do(clean):
    lab, _, _ = clean
    assert distance_of_arms_m(lab) > SETTINGS.margin_m - 0.5e-3  # the drive lags behind its set-points
    assert named(lab, "guard") == [] and lab.record().collisions == ()


def test_one_arm_alone_is_refused():
    with pytest.raises(TrocarError, match=r"needs two arms, and was given psm1"):
        Bilateral(briefed(ideal_laboratory(standing(0)), "bilateral", FIRST, arms=("psm1",)))


def test_a_person_chooses_for_each_arm_among_its_own_transfers():
    goals, person = GOALS["bilateral"][:4], Chooser(1, 1, 0, 0)
    lab, in_time, scores = played("bilateral", goals, person=person)
    assert in_time and all(score.succeeded for score in scores)
    noted = [(next(iter(event["turns"])), event["goal"]) for event in named(lab, "transfer")]
    assert [goal for arm, goal in noted if arm == "psm2"] == [2, 0]
    assert [goal for arm, goal in noted if arm == "psm1"] == [3, 1]
    assert [{goal.arm for goal in offered} for offered in person.offered[:2]] == [{"psm2"}, {"psm1"}]
