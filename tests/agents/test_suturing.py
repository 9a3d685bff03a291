"""One arm drives sutures in a cell without cable errors."""

import math

import numpy as np
import pytest

from simulated import ideal_session
from trocar.agents import CircleSuturing, SutureSettings
from trocar.agents.suture import along
from trocar.arms import limit_violations
from trocar.cell import Cell, Outcome
from trocar.errors import TrocarError
from trocar.robots import Recorded
from trocar.sim.cell import SimulatedCell
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.sutures import suture_joints
from trocar.sutures.drive import Suture
from trocar.tasks import CircleSutures
from trocar.trials import TrialLog

TASK = CircleSutures()
SETUP = TASK.setup
QUICK = SutureSettings(driving_speed=0.016, travel_speed=0.05)
"""Twice as fast as the defaults, so that the tests are too."""


class Nobody:
    """An assistant who loads nothing."""

    async def load(self, arm):
        """Do nothing."""


def drive(sutures, assistant=None):
    """Return the cell, its log, what was asked of the arm, and the scores."""
    session = ideal_session(TASK.T_world_base)
    simulated = SimulatedCell(
        session, TASK.scene(np.random.default_rng(0)), np.random.default_rng(0), SensorFlaws.none()
    )
    log = TrialLog(lambda: simulated.world.time_s)
    robot = Recorded(simulated.robot)
    cell = Cell(
        robot,
        simulated.camera,
        session.arms,
        session.T_world_base_found,
        simulated.T_world_camera,
        TASK.T_world_board,
        log,
        assistant or simulated.assistant,
    )
    agent = CircleSuturing(cell, QUICK)
    assert simulated.run(lambda: agent.run(sutures), TASK.budget_s)
    return simulated, log, robot


def outcomes(log):
    return [event["outcome"] for event in log.events if event["name"] == "suture"]


@pytest.fixture(scope="module")
def two_sutures():
    return drive(TASK.work[:2])


def test_sutures_are_driven_in_and_out_where_they_were_planned(two_sutures):
    simulated, log, _ = two_sutures
    scores = TASK.score(log.events, simulated.referee.truth())
    assert [score.failure for score in scores] == ["", ""]
    for score in scores:
        assert score.entry_error_m < 0.3e-3 and score.exit_error_m < 0.5e-3
        assert score.tip_max_m < 0.6e-3
        assert score.slip_m < 0.3e-3


def test_each_step_of_the_primitive_is_done_once_in_order(two_sutures):
    _, log, _ = two_sutures
    names = [event["step"] for event in log.events if event["name"] == "step" and event["suture"] == 1]
    primitive = ["penetrate", "rotate", *(f"{w} {k}" for k in (1, 2) for w in ("regrasp", "push"))]
    assert names == ["lower", "approach", *primitive, "withdraw", "rise"]


def test_no_joint_is_ever_asked_out_of_its_range(two_sutures):
    _, _, robot = two_sutures
    q = np.concatenate([rows for _, _, rows in robot.asked])
    assert limit_violations(SETUP.arm, q) == []


def test_a_joint_limit_stops_it_there_and_it_says_which():
    bad = TASK.work[1]
    forced = Suture(SETUP, bad.theta_rad, -bad.direction)
    assert not suture_joints(SETUP, [bad.theta_rad]).feasible[0 if forced.direction == 1 else 1, 0]
    simulated, log, robot = drive([forced, TASK.work[2]])
    assert outcomes(log) == [Outcome.JOINT_LIMIT.name]  # the next is not even begun
    (event,) = [event for event in log.events if event["name"] == "suture"]
    for words in ("suture 1, rotate", "wrist_pitch", "outside [-80.0, 80.0] deg", "stopped there"):
        assert words in event["reason"]
    last = robot.asked[-1][2][-1]
    near = np.minimum(SETUP.arm.upper - last, last - SETUP.arm.lower)[[0, 1, 3, 4, 5]]
    assert 0.0 <= near.min() < math.radians(3.0)  # it drove up to the limit
    (score,) = TASK.score(log.events, simulated.referee.truth())
    assert (score.succeeded, score.failure) == (False, "JOINT_LIMIT")


def test_jaws_that_were_given_nothing_say_so():
    _, log, _ = drive(TASK.work[:1], Nobody())
    assert outcomes(log) == [Outcome.NEEDLE_MISSED.name]
    assert not [event for event in log.events if event["name"] == "step"]


def test_a_cell_without_an_assistant_is_refused():
    session = ideal_session(TASK.T_world_base)
    cell = Cell(None, None, session.arms, session.T_world_base, None, TASK.T_world_board, None)
    with pytest.raises(TrocarError, match="nobody in this cell loads the needle"):
        CircleSuturing(cell, SutureSettings())
    with pytest.raises(TrocarError, match="arm 'psm3' is not in this cell; choose one of psm1"):
        CircleSuturing(cell, SutureSettings(arm="psm3"))


def test_a_motion_along_a_path_keeps_to_it_and_rests_at_both_ends():
    share = np.linspace(0.0, 1.0, 30)[:, None]
    path = np.hstack([np.sin(share * (k + 1)) for k in range(6)])
    motion = along(path, 2.0)
    assert motion.duration_s == pytest.approx(2.0)
    np.testing.assert_allclose(motion([0.0, 2.0]), path[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(motion([0.0, 2.0], 1), 0.0, atol=1e-12)
    q = motion(np.linspace(0.0, 2.0, 200))
    fine = np.hstack([np.sin(np.linspace(0, 1, 60_000)[:, None] * (k + 1)) for k in range(6)])
    assert max(np.abs(fine - row).max(axis=1).min() for row in q) < 1e-4
