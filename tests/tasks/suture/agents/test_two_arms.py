"""Two arms sew without a person: from the stand, through the tissue, from hand to hand; failures have names."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sewing import briefed, sewing_laboratory
from simulated import coarse
from trocar.errors import InvalidInput, OutOfReach
from trocar.lab import load_station
from trocar.tasks.suture.agents import agent_of
from trocar.tasks.suture.agents.circle import CircleSuturing, Settings
from trocar.tasks.suture.agents.two_arms import TwoArmSuturing
from trocar.tasks.suture.planning.segments import retreat
from trocar.tasks.suture.score import ON_TARGET_M, score_sutures
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures(variant="two-arms")
GOALS = TASK.goals()
STATION = coarse(TASK.at(load_station(TASK.usual_station)))
ARMS = TASK.working_arms(STATION)
BLIND = Settings(driving_speed_m_s=0.016, travel_speed_m_s=0.05, images=0)
"""Faster than the defaults, so that the tests are too; where nothing errs, nothing has to be looked at."""

LOOKING = replace(BLIND, images=1)

laboratory = partial(sewing_laboratory, TASK, STATION)
told = partial(briefed, sutures=GOALS[:1], settings=BLIND, arms=ARMS)


def sew(sutures, change=lambda agent: None, settings=BLIND):
    """Return the laboratory in which these sutures were sewn, and their scores; ``change`` sees the agent first."""
    lab = laboratory()
    agent = agent_of(briefed(lab.cell, sutures, settings, ARMS))
    change(agent)
    assert lab.run(lambda cell: agent.run(), TASK.budget_s)
    return lab, score_sutures(sutures, lab.truth(), lab.log.events)


def opens_during(agent, wanted):
    """Have the second arm's jaws open half-way along its first step of this name, and close at its end."""
    follow = agent.puller.follow

    async def follow_and_open(segment, speed_m_s):
        if segment.name != wanted:
            return await follow(segment, speed_m_s)
        agent.puller.follow = follow
        assert await follow(segment.first(len(segment.q) // 2), speed_m_s)
        await agent.puller.hand.jaw(agent.settings.jaw_open_rad)
        await follow(replace(segment, q=segment.q[len(segment.q) // 2 :]), speed_m_s)
        await agent.puller.hand.jaw(agent.settings.jaw_closed_rad)
        return True

    agent.puller.follow = follow_and_open


def steps(lab, suture):
    return [e["step"] for e in lab.log.events if e["name"] == "step" and e["suture"] == suture]


def test_as_many_arms_as_work_get_their_agent():
    cell = laboratory().cell
    assert type(agent_of(told(cell))) is TwoArmSuturing
    with pytest.raises(InvalidInput, match="loads the needle"):
        agent_of(told(cell, arms=ARMS[:1]))
    helped = replace(cell, assistants={"load needle": None})
    assert type(agent_of(told(helped, arms=ARMS[:1]))) is CircleSuturing


def test_a_cell_without_a_stand_is_refused():
    cell = laboratory().cell
    fixtures = {name: T for name, T in cell.T_world_fixture.items() if name != "stand"}
    with pytest.raises(InvalidInput, match="no fixture 'stand'"):
        agent_of(told(replace(cell, T_world_fixture=fixtures)))


@pytest.fixture(scope="module")
def two_sutures():
    return sew(GOALS[:2])


@pytest.mark.slow
def test_two_arms_sew_two_sutures_in_and_out_where_they_were_planned(two_sutures):
    _, scores = two_sutures
    assert [score.failure for score in scores] == ["", ""]
    for score in scores:  # without looks, nothing makes up for what jaws do that close on a needle
        assert score.entry_error_m < ON_TARGET_M and score.exit_error_m < ON_TARGET_M


@pytest.mark.slow
def test_the_first_needle_is_from_the_stand_and_the_next_from_the_second_arm(two_sutures):
    lab, _ = two_sutures
    assert steps(lab, 0)[0] == "take from stand" and steps(lab, 1)[0] == "hand over"
    for suture in (0, 1):
        assert [step for step in steps(lab, suture) if step in ("grasp tip", "pull through")] == [
            "grasp tip",
            "pull through",
        ]
    assert lab.cell.assistants == {}


@pytest.mark.slow
def test_at_the_end_the_second_arm_has_the_needle_out_of_the_tissue(two_sutures):
    lab, _ = two_sutures
    truth = lab.truth()
    assert truth.in_hand[-1] and not truth.gripped[-1]
    assert truth.p_circle_needle_tip_m[-1, 2] > 0.01


@pytest.mark.slow
def test_a_handover_that_an_arm_refuses_is_tried_elsewhere_and_then_has_a_name():
    """The second arm cannot hold the needle out anywhere."""

    def unable(agent):
        async def present(handover):
            tried.append(handover)
            return False

        agent.puller.present = present

    tried = []
    _, scores = sew(GOALS[:2], unable)
    assert [score.failure for score in scores] == ["", "HANDOVER_REFUSED"]
    assert len(tried) == len(TASK.plan_with(STATION).handovers[0]) > 1


@pytest.mark.slow
def test_a_needle_that_the_second_arm_drops_ends_the_trial_by_its_name():
    def clumsy(agent):
        pull = agent.puller.pull

        async def pull_and_drop(planned):
            await pull(planned)
            await agent.puller.hand.jaw(agent.settings.jaw_open_rad)
            return False

        agent.puller.pull = pull_and_drop

    lab, scores = sew(GOALS[:2], clumsy)
    noted = [event["outcome"] for event in lab.log.events if event["name"] == "suture"]
    assert noted == ["NEEDLE_DROPPED", "NOT_DRIVEN"]
    assert [score.failure for score in scores] == ["", "NOT_DRIVEN"], "the first was through before it fell"
    assert "neither arm has the needle, and nothing looks for it" in scores[1].reason


@pytest.mark.slow
@pytest.mark.parametrize("wanted", ["rotate", "push 2"])
def test_a_needle_that_the_first_arm_loses_in_the_tissue_is_found_there_and_driven_on(wanted):
    def clumsy(agent):
        follow = agent.follow

        async def follow_and_open(number, segment, speed_m_s=None):
            if segment.name != wanted or len(segment.q) < 8:
                return await follow(number, segment, speed_m_s)
            agent.follow = follow
            half = len(segment.q) // 2
            assert not await follow(number, segment.first(half), speed_m_s)
            await agent.hand.jaw(agent.settings.jaw_open_rad)
            for away in retreat(GOALS[0].setup, agent.hand.q):
                assert not await follow(number, away)
            await agent.hand.jaw(agent.settings.jaw_closed_rad)
            return ""

        agent.follow = follow_and_open

    lab, scores = sew(GOALS[:1], clumsy, LOOKING)
    assert [event["name"] for event in lab.log.events].count("needle lost") == 1
    assert [score.failure for score in scores] == [""]


@pytest.mark.slow
def test_a_needle_that_falls_is_found_where_it_lies_and_the_arms_retreat():
    lab, scores = sew(GOALS[:3], lambda agent: opens_during(agent, "lift"), LOOKING)
    assert [score.failure for score in scores] == ["", "NOT_DRIVEN", "NOT_DRIVEN"]
    lies = next(event for event in lab.log.events if event["name"] == "needle lies")
    needle = lab.truth().T_circle_needle[-1].translation_m
    np.testing.assert_allclose([float(lies["x_mm"]), float(lies["y_mm"])], 1e3 * needle[:2], atol=0.2)
    assert f"lies at x {lies['x_mm']:.1f} mm, y {lies['y_mm']:.1f} mm" in scores[1].reason
    for name in ARMS:
        assert lab.cell.robot.setpoint(name).q == pytest.approx(STATION.arm(name).park_q(), abs=1e-6)


@pytest.mark.slow
def test_a_needle_that_the_second_arm_loses_in_the_tissue_is_found_there_and_pulled_on():
    lab, scores = sew(GOALS[:1], lambda agent: opens_during(agent, "pull"), LOOKING)
    assert [event["name"] for event in lab.log.events].count("needle lost") == 1
    assert [score.failure for score in scores] == [""]
    truth = lab.truth()
    assert truth.in_hand[-1] and truth.p_circle_needle_tip_m[-1, 2] > 0.01


def test_arms_that_cannot_do_their_part_say_so_before_anything_moves():
    lab = laboratory()
    away = {ARMS[1]: lab.cell.T_world_base_registered[ARMS[0]]}
    cell = replace(lab.cell, T_world_base_registered=lab.cell.T_world_base_registered | away)
    agent = agent_of(told(cell))
    with pytest.raises(OutOfReach, match="second arm"):
        lab.run(lambda cell: agent.begin(), 60.0)
