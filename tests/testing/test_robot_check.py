"""Every robot of the package passes; a robot that breaks a promise is found out."""

from dataclasses import replace

import numpy as np
import pytest

from simulated import PAPER, ideal_laboratory, standing
from trocar.calibration.models import OffsetModel, TrainingMotion
from trocar.motion import rest_to_rest
from trocar.robots.compensated import Compensated
from trocar.testing import CheckFailed, check_robot
from trocar.trajectory import Trajectory

BUDGET_S = 100.0


@pytest.fixture
def laboratory():
    return ideal_laboratory(standing(0))


def checked(laboratory, robot=None, arm="psm1", **options):
    """Check a robot, if it is another one, in the laboratory's cell."""

    async def script(cell):
        await check_robot(cell if robot is None else replace(cell, robot=robot), arm, **options)

    assert laboratory.run(script, BUDGET_S)


@pytest.mark.parametrize("arm", ["psm1", "psm2"])
def test_the_guarded_arms_of_a_simulated_cell_pass(laboratory, arm):
    checked(laboratory, arm=arm)


def test_a_compensated_robot_passes(laboratory):
    model = OffsetModel(np.full(6, 0.01) * [0, 0, 0, 1, 1, 1], TrainingMotion(*np.ones((3, 6)), 30))
    cell = laboratory.cell
    limits = {name: arm.motion_limits for name, arm in cell.arms.items()}
    robot = Compensated(cell.robot, cell.arms, {"psm1": model}, limits, cell.clock, cell.log)
    checked(laboratory, robot, tolerance=0.05)


class Spoilt:
    """A robot that is another one, but for what a test changes."""

    def __init__(self, robot):
        self._robot = robot

    def __getattr__(self, name):
        return getattr(self._robot, name)


class AnswersAtOnce(Spoilt):
    async def move(self, motions):
        at = {arm: self._robot.setpoint(arm).q for arm in motions}
        still = {arm: Trajectory.hermite([0.0, 0.02], np.array([q, q]), np.zeros((2, 6))) for arm, q in at.items()}
        return await self._robot.move(still)


class ForgetsWhy(Spoilt):
    def hold(self, *arms, reason=""):
        self._robot.hold(*arms)


class ReplacesByHolding(Spoilt):
    async def replace(self, motions):
        self._robot.hold(*motions)
        await self._robot.rest(*motions)
        ends = {arm: motion(motion.duration_s) for arm, motion in motions.items()}
        return await self._robot.move(
            {arm: rest_to_rest(self._robot.setpoint(arm).q, end, PAPER) for arm, end in ends.items()}
        )


class StrayEncoders(Spoilt):
    def read(self, arm):
        reading = self._robot.read(arm)
        return replace(reading, q=reading.q + [0, 0, 0, 0, 0.2, 0])


class DropsItsJaw(Spoilt):
    async def jaw(self, arm, angle_rad):
        return await self._robot.jaw(arm, 0.5 * angle_rad)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (AnswersAtOnce, "s for a motion, not"),
        (ForgetsWhy, "HELD with the reason given"),
        (ReplacesByHolding, "end a replaced motion as REPLACED"),
        (StrayEncoders, "read what was commanded at rest"),
        (DropsItsJaw, "rad of its jaws there, not"),
    ],
)
def test_a_broken_promise_is_found(laboratory, kind, words):
    with pytest.raises(BaseException) as raised:
        checked(laboratory, kind(laboratory.cell.robot))
    error = raised.value
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, CheckFailed) and words in str(error)
