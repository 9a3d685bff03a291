"""Debridement as a task: its options, and its requirements on a station."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.eval import TASKS
from trocar.eval.config import RunConfig
from trocar.lab import load_station
from trocar.tasks.debridement.goals import FragmentOutcome
from trocar.tasks.debridement.task import Debridement


@pytest.fixture(scope="module")
def station():
    return load_station("raven-pair")


def test_it_is_registered():
    assert TASKS["debridement"] is Debridement


@pytest.mark.parametrize(("arms", "variant"), [(1, "one-arm"), (2, "two-arms")])
def test_one_arm_or_two_work(station, arms, variant):
    task = Debridement(arms=arms)
    assert task.variant == variant
    assert task.working_arms(task.at(station)) == ("left", "right")[:arms]
    assert RunConfig(task).about()["variant"] == variant


def test_there_is_one_goal_for_each_fragment(station):
    task = Debridement(fragments=3)
    assert [goal.number for goal in task.goals()] == [0, 1, 2]
    assert task.nominal().fragments == 3
    assert len(task.scene(np.random.default_rng(0), station).fragments) == 3


def test_the_referee_looks_from_both_eyes(station):
    eyes = Debridement().scene(np.random.default_rng(0), station).p_world_eyes_m
    assert np.linalg.norm(eyes[1] - eyes[0]) == pytest.approx(0.0468)
    assert eyes[0] == pytest.approx(station.cameras["stereo"].T_world_camera.translation_m)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"arms": 3}, "the number of arms is 3; give 1 or 2 with --arms"),
        ({"fragments": 0}, "the number of fragments is 0; give 1 to 12 with --fragments"),
        ({"fragments": 13}, "give 1 to 12"),
        ({"backdrop": "sea"}, "backdrop 'sea' is unknown; choose one of plain, tissue"),
        ({"budget_s": 0.0}, "the budget of a trial is 0.0 s"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, sentence):
    with pytest.raises(TrocarError, match=sentence):
        Debridement(**options)


@pytest.mark.parametrize("fixture", ["table", "receptacle"])
def test_a_station_without_a_fixture_is_refused(station, fixture):
    fixtures = {name: T for name, T in station.T_world_fixture.items() if name != fixture}
    with pytest.raises(TrocarError, match=f"'raven-pair' has no fixture '{fixture}'"):
        Debridement().at(replace(station, T_world_fixture=fixtures))


def test_a_station_without_two_eyes_is_refused(station):
    with pytest.raises(TrocarError, match="has no camera 'stereo' with two eyes"):
        Debridement().at(replace(station, cameras={}))
    other = load_station("peg-transfer").cameras["overhead"]
    with pytest.raises(TrocarError, match="has no camera 'stereo' with two eyes"):
        Debridement().at(replace(station, cameras={"stereo": other}))


def test_two_arms_need_two_arms(station):
    alone = replace(station, arms={"left": station.arms["left"]})
    with pytest.raises(TrocarError, match="has one arm, and debridement --arms 2 needs two"):
        Debridement().at(alone)
    assert Debridement(arms=1).at(alone).arms == alone.arms


def test_an_arm_that_does_not_work_is_drawn_back_into_its_port(station):
    one, two = Debridement(arms=1).at(station), Debridement(arms=2).at(station)
    assert two.arms == station.arms and one.arms["left"] == station.arms["left"]
    lifted = one.arms["right"].park_q() - station.arms["right"].park_q()
    assert lifted.tolist() == pytest.approx([0, 0, 0.1, 0, 0, 0])


def test_the_nine_failure_modes_that_end_a_fragment_s_handling_have_a_sentence():
    names = {"NOT_FOUND", "GRASP_FAILURE", "MULTIPLE_GRASP", "PICKUP_FAILURE", "DROPPED_EN_ROUTE", "DROPOFF_FAILURE"}
    assert names <= set(FragmentOutcome.__members__)
    assert len({outcome.value for outcome in FragmentOutcome}) == len(FragmentOutcome)
