"""One arm drives sutures in a cell without cable errors."""

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from sewing import briefed, sewing_laboratory
from simulated import coarse
from trocar.arms import limit_violations
from trocar.cell import SEAT
from trocar.errors import ArmStopped, InvalidInput, OutOfReach, TrocarError
from trocar.lab import load_station
from trocar.tasks.suture.agents import circle
from trocar.tasks.suture.agents.circle import LOAD, CircleSuturing, Settings
from trocar.tasks.suture.agents.needle_tracker import NeedleTracker
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import suture_joints
from trocar.tasks.suture.planning.primitive import Suture
from trocar.tasks.suture.planning.segments import FREE_M_S, suture_segments
from trocar.tasks.suture.score import score_sutures
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures()
GOALS = TASK.goals()
STATION = coarse(TASK.at(load_station("suture")))
SETUP = TASK.setup
QUICK = Settings(driving_speed_m_s=0.012)
"""Faster than the defaults, so that the tests are too."""
UNSEEN = replace(QUICK, images=0)
"""Where an arm can go in one suture does not depend on looks at the needle."""

laboratory = partial(sewing_laboratory, TASK, STATION)
told = partial(briefed, sutures=GOALS[:1], settings=QUICK)


async def nobody(arm):
    """Load nothing."""
    del arm


def drive(sutures, load=None, settings=QUICK, refusing=(), choose=None):
    """Return the laboratory in which these sutures were driven, by a robot that may be ``Refusing``, and scores."""
    lab = laboratory()
    if load:
        lab.cell = replace(lab.cell, assistants={LOAD: load})
    if choose:
        seated = {**lab.cell.assistants, SEAT: SimpleNamespace(choose=choose)}
        lab.cell = replace(lab.cell, assistants=seated)
    if refusing:
        lab.cell = replace(lab.cell, robot=Refusing(lab.cell.robot, *refusing))
    agent = CircleSuturing(briefed(lab.cell, sutures, settings))
    assert lab.run(lambda cell: agent.run(), TASK.budget_s)
    return lab, score_sutures(sutures, lab.truth(), lab.log.events)


def named(lab, name):
    return [event for event in lab.log.events if event["name"] == name]


def outcomes(lab):
    return [event["outcome"] for event in named(lab, "suture")]


@pytest.fixture(scope="module")
def two_sutures():
    return drive(GOALS[:2])


def test_sutures_are_driven_in_and_out_where_they_were_planned(two_sutures):
    _, scores = two_sutures
    assert [score.failure for score in scores] == ["", ""]
    for score in scores:
        assert score.entry_error_m < 0.3e-3 and score.exit_error_m < 0.5e-3
        assert score.tip_max_m < 0.6e-3
        assert score.slip_m < 0.3e-3


def test_each_step_of_the_primitive_is_done_once_in_order(two_sutures):
    lab, _ = two_sutures
    names = [event["step"] for event in named(lab, "step") if event["suture"] == 1]
    primitive = ["penetrate", "rotate", *(f"{w} {k}" for k in (1, 2) for w in ("regrasp", "push"))]
    assert names == ["lower", "approach", *primitive, "withdraw", "rise"]


def test_no_joint_is_ever_asked_out_of_its_range(two_sutures):
    lab, _ = two_sutures
    assert limit_violations(SETUP.arm, lab.recorder.joints("desired")["psm1"][:, :6]) == []


def test_every_part_is_noted_and_what_is_sent_keeps_the_limits(two_sutures):
    lab, _ = two_sutures
    assert {span.name for span in lab.log.spans} == {
        *("planning", "loading", "motion", "jaw", "settling", "looking", "perception")
    }
    assert max(lab.driver.limit_use("psm1")) <= 1.0 + 1e-3
    assert lab.log.events[-1]["outcome"] == SutureOutcome.DONE.name
    assert np.abs(lab.cell.robot.setpoint("psm1").q - STATION.arms["psm1"].park_q()).max() < 1e-6


@pytest.fixture(scope="module")
def unseen_suture():
    lab, (score,) = drive(GOALS[:1], settings=UNSEEN)
    assert score.succeeded
    return lab


def test_the_way_in_is_travelled_and_the_needle_is_driven_at_their_own_speeds(unseen_suture):
    begins = {event["step"]: event["time_s"] for event in named(unseen_suture, "step")}
    motions = [span for span in unseen_suture.log.spans if span.name == "motion"]
    speeds = {"lower": FREE_M_S["lower"], "penetrate": UNSEEN.driving_speed_m_s, "rotate": UNSEEN.driving_speed_m_s}
    for piece, then in pairwise(suture_segments(GOALS[0])):
        if piece.name in speeds:
            last = [m for m in motions if begins[piece.name] <= m.start_s < begins[then.name] - 1e-6][-1]
            took_s = last.end_s - last.start_s
            assert took_s == pytest.approx(piece.length_m / speeds[piece.name], abs=0.011), piece.name


def test_jaws_that_went_back_beyond_the_next_grip_have_come_forward_to_it_when_they_push(unseen_suture):
    begins = {event["step"]: event["time_s"] for event in named(unseen_suture, "step")}
    desired = unseen_suture.recorder.joints("desired")["psm1"][:, :6]
    pushes = [piece for piece in suture_segments(GOALS[0]) if piece.name.startswith("push")]
    for piece in pushes:
        np.testing.assert_allclose(desired[round(begins[piece.name] / 0.01)], piece.q[0], atol=1e-3)
    assert len(pushes) == 2


def test_a_joint_limit_stops_it_there_and_it_says_which():
    bad = GOALS[1]
    forced = Suture(SETUP, bad.theta_rad, -bad.direction)
    assert not suture_joints(SETUP, [bad.theta_rad]).feasible[0 if forced.direction == 1 else 1, 0]
    lab, scores = drive([forced, GOALS[2]], settings=UNSEEN)
    assert outcomes(lab) == [SutureOutcome.JOINT_LIMIT.name]  # the next is not even begun
    (event,) = named(lab, "suture")
    for words in ("suture 1, rotate", "wrist_pitch", "outside [-80.0 deg, 80.0 deg]", "stopped there"):
        assert words in event["reason"]
    (stopped,) = named(lab, "stopped")
    assert (stopped["outcome"], stopped["reason"]) == ("JOINT_LIMIT", event["reason"])
    last = lab.cell.robot.setpoint("psm1").q
    near = np.minimum(SETUP.arm.upper - last, last - SETUP.arm.lower)[[0, 1, 3, 4, 5]]
    assert 0.0 <= near.min() < math.radians(3.0)  # it drove up to the limit
    assert {(score.succeeded, score.failure) for score in scores} == {(False, "JOINT_LIMIT")}


@pytest.mark.parametrize("side", [1, -1])
def test_it_says_how_far_a_joint_would_have_to_go_on_the_side_where_it_leaves_its_range(side, monkeypatch):
    """Each segment goes there and back, so that the joint is within its range again at the end."""
    forced = Suture(SETUP, GOALS[1].theta_rad, -GOALS[1].direction)
    planned = suture_segments(forced)
    pitch = np.concatenate([segment.q[:, 4] for segment in planned])
    turned = np.ones(6)
    turned[4] = side * np.sign(pitch[np.argmax(np.abs(pitch))])  # the wrist's pitch leaves its range on this side
    there = [replace(segment, q=turned * segment.q) for segment in planned]
    segments = tuple(replace(segment, q=np.concatenate([segment.q, segment.q[::-1]])) for segment in there)
    monkeypatch.setattr(circle, "suture_segments", lambda suture: segments)
    lab, _ = drive([forced], settings=UNSEEN)
    farthest_deg = np.degrees(np.abs(np.concatenate([piece.q[:, 4] for piece in segments])).max())
    assert farthest_deg > 80.0
    assert (
        f"joint 'wrist_pitch' would go to {side * farthest_deg:.1f} deg, outside" in named(lab, "suture")[0]["reason"]
    )


class Refusing:
    """A robot that refuses motions which bring a joint beyond a limit, as one does that makes up for cables."""

    def __init__(self, robot, joint, most_rad, error=None):
        self._robot, self._joint, self._most_rad = robot, joint, most_rad
        self._error = error or OutOfReach("joint would need the command 82.0 deg to make up for its cables")

    def __getattr__(self, name):
        return getattr(self._robot, name)

    async def move(self, motions):
        for motion in motions.values():
            if motion.sample(0.01)[1][:, self._joint].max() > self._most_rad:
                raise self._error
        return await self._robot.move(motions)


def test_the_arm_comes_down_from_as_high_as_commands_allow():
    lower = suture_segments(GOALS[3])[0].q[:, 5]
    lab, (score,) = drive([GOALS[3]], settings=UNSEEN, refusing=(5, float(lower[0]) - math.radians(1.0)))
    assert outcomes(lab) == [SutureOutcome.DONE.name] and score.succeeded


def test_an_arm_that_has_stopped_ends_the_trial_and_not_one_suture():
    with pytest.raises(ArmStopped, match="drive is off"):
        drive(GOALS[:2], settings=UNSEEN, refusing=(5, -10.0, ArmStopped("psm1", "its drive is off")))


@pytest.mark.slow
def test_a_command_that_leaves_a_joints_range_costs_one_suture_only(monkeypatch):
    monkeypatch.setattr(circle, "SHORT", ())
    pushed = suture_segments(GOALS[1])[3].q[:, 4]
    lab, scores = drive([GOALS[1], GOALS[0]], refusing=(4, float(pushed.max()) - math.radians(5.0)))
    assert outcomes(lab) == [SutureOutcome.JOINT_LIMIT.name, SutureOutcome.DONE.name]
    assert "suture 1, rotate: joint would need the command 82.0 deg" in named(lab, "suture")[0]["reason"]
    steps = [event["step"] for event in named(lab, "step") if event["suture"] == 0]
    assert steps[-2:] == ["withdraw", "rise"] and named(lab, "stopped") == []
    assert [score.succeeded for score in scores] == [False, True]


@pytest.mark.slow
def test_a_turn_that_commands_do_not_allow_to_the_end_stops_short_of_it():
    pushed = suture_segments(GOALS[1])[3].q[:, 4]
    lab, (score,) = drive([GOALS[1]], refusing=(4, float(pushed.max()) - math.radians(4.0)))
    assert outcomes(lab) == [SutureOutcome.DONE.name]
    assert score.entry_error_m < 0.5e-3 and score.exit_error_m < 1e-3


def test_a_person_chooses_which_suture_is_next():
    offered = []

    async def choose(goals):
        offered.append([goal.words for goal in goals])
        return len(goals) - 1

    lab, scores = drive(GOALS[:3], nobody, choose=choose)
    assert [event["suture"] for event in named(lab, "suture")] == [2, 1, 0]
    assert [score.failure for score in scores] == ["NEEDLE_MISSED"] * 3
    assert [len(words) for words in offered] == [3, 2, 1] and offered[0][2] == f"drives suture 3, {GOALS[2]}"


def test_jaws_that_were_given_nothing_say_so():
    lab, (score,) = drive(GOALS[:1], nobody)
    assert sum(span.name == "loading" for span in lab.log.spans) == QUICK.loadings
    assert outcomes(lab) == [SutureOutcome.NEEDLE_MISSED.name]
    assert named(lab, "step") == []
    assert (score.succeeded, score.failure) == (False, "NEEDLE_MISSED")
    assert score.entry_error_m is None


@pytest.mark.slow
def test_a_needle_that_is_badly_loaded_is_loaded_anew_as_often_as_allowed(monkeypatch):
    monkeypatch.setattr(NeedleTracker, "well_loaded", property(lambda tracker: False))
    lab = laboratory()
    agent = CircleSuturing(told(lab.cell))
    assert not lab.run(lambda cell: agent.run(), 15.0)
    assert "penetrate" in [event["step"] for event in named(lab, "step")], "then it is driven nevertheless"
    assert len(named(lab, "loaded anew")) == QUICK.loadings - 1


def test_a_cell_without_an_assistant_is_refused():
    lab = laboratory()
    with pytest.raises(InvalidInput, match="nobody in this cell loads the needle"):
        CircleSuturing(told(replace(lab.cell, assistants={})))
    with pytest.raises(TrocarError, match=r"arm 'psm3' is unknown; .*choose one of psm1"):
        CircleSuturing(told(lab.cell, arms=("psm3",)))
