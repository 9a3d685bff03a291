"""Two arms that do transfers at once."""

import pytest

from simulated import ideal_laboratory, standing
from trocar.errors import TrocarError
from trocar.tasks.kit import Brief
from trocar.tasks.peg_transfer.agents.bilateral import Bilateral
from trocar.tasks.peg_transfer.goals import GOALS, PegSet, TransferOutcome
from two_armed import SETTINGS, at_rest, distance_of_arms_m, named, no_way, played, silent

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


def test_an_arm_that_stops_answering_does_not_keep_the_other_from_its_work():
    lab, in_time, (left, right) = played("bilateral", FIRST, robot=silent("psm2", 5))
    assert in_time and at_rest(lab)
    assert right.succeeded
    assert (left.succeeded, left.failure, left.reason) == (False, "ARM_STOPPED", "psm2 is silent")


def test_a_block_that_is_not_there_is_an_outcome():
    lab, in_time, (left, right) = played("bilateral", FIRST, blocks=(RIGHT.source,))
    assert in_time and at_rest(lab)
    assert (left.failure, right.succeeded) == ("NO_BLOCK", True)


def test_a_planner_that_finds_nothing_is_an_outcome_of_every_transfer():
    lab, in_time, scores = played("bilateral", FIRST, planner=no_way)
    assert in_time and at_rest(lab)
    assert {score.failure for score in scores} == {TransferOutcome.OUT_OF_REACH.name}
    assert "finds nothing" in named(lab, "no motion")[0]["reason"]


def test_one_arm_alone_is_refused():
    lab = ideal_laboratory(standing(0))
    brief = Brief(lab.cell, FIRST, PegSet(variant="bilateral"), ("psm1",), no_way, None, None, SETTINGS)  # type: ignore
    with pytest.raises(TrocarError, match=r"needs two arms, and was given psm1"):
        Bilateral(brief)
