"""A person beside real arms, whose clock nobody can stop."""

import time

import numpy as np
import pytest

import echo_arms
from driven import HOME
from trocar.console import Console
from trocar.errors import EmergencyStop
from trocar.eval.on_robot import _run_until_refused
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import LoopSettings
from trocar.lab import load_station
from trocar.motion import rest_to_rest
from trocar.view.wishes import Held, Level, Said, Wish

pytestmark = pytest.mark.realtime
STATION = load_station("peg-transfer")
LIMITS = {name: arm.limits for name, arm in STATION.arms.items()}
RELAXED = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0)
FAR = HOME + np.array([0.3, 0.2, -0.02, 0.9, 0.5, -0.6])
MOTION = rest_to_rest(HOME, FAR, LIMITS["psm1"]).stretched(4.0)


class Beside:
    """An attendant whose person says things at times since the laboratory began."""

    def __init__(self, laboratory, plan, level=Level.AUTONOMOUS):
        self.plan, self.began_s, self.told = plan, time.monotonic(), []
        self.console = Console(level, hear=self._hear, show=self._show, paced=False)
        laboratory.wrap_robot(self.console.supervise)

    def _hear(self):
        due = [say for at_s, say in self.plan if time.monotonic() - self.began_s >= at_s]
        self.plan = self.plan[len(due) :]
        return [say() for say in due]

    def _show(self):
        self.told.append(self.console.standing)

    async def serve(self, cell):
        await self.console.serve(cell)

    @property
    def asks(self):
        return self.console.asks


@pytest.fixture
def laboratory():
    with HardwareLaboratory(STATION, echo_arms.connect, RELAXED) as laboratory:
        yield laboratory


async def there(cell):
    assert (await cell.robot.move({"psm1": MOTION}))["psm1"].done


def q(laboratory):
    return laboratory.cell.robot.setpoint("psm1").q


def test_a_stopped_arm_goes_on_when_the_person_says_so(laboratory):
    beside = Beside(laboratory, [(0.4, lambda: Said(Wish.STOP)), (3.0, lambda: Said(Wish.GO_ON))])
    assert _run_until_refused(laboratory, beside, there, 60.0)
    np.testing.assert_allclose(q(laboratory), FAR, atol=1e-6)
    assert time.monotonic() - beside.began_s > 3.0


def test_a_motion_waits_for_a_yes_which_costs_none_of_its_budget_and_its_page_offers_no_clock(laboratory):
    budget_s = MOTION.duration_s + 2.0
    beside = Beside(laboratory, [(2.5, lambda: Said(Wish.YES))], Level.MOTIONS)
    assert _run_until_refused(laboratory, beside, there, budget_s)
    assert time.monotonic() - beside.began_s > 2.5 + MOTION.duration_s
    assert any(standing.asks for standing in beside.told)
    assert {standing.speed for standing in beside.told} == {None}


def test_the_emergency_stop_ends_the_script_with_the_arm_at_rest_on_its_path(laboratory):
    beside = Beside(laboratory, [(0.4, lambda: Said(Wish.EMERGENCY))])
    with pytest.raises(EmergencyStop):
        _run_until_refused(laboratory, beside, there, 60.0)
    assert not laboratory.cell.robot.setpoint("psm1").moving
    assert max(laboratory.robot.limit_use("psm1")) <= 1.001
    on_path = np.abs(MOTION(np.linspace(0, MOTION.duration_s, 20_000)) - q(laboratory)).max(1).min()
    assert on_path < 1e-3


def test_a_hand_moves_an_arm_and_gives_it_back(laboratory):
    tips_m = []

    def hold(shift_m):
        def say():
            tips_m.append(beside.console.hands["psm1"].tip.translation_m)
            return Said(Wish.HOLD, "psm1", Held(np.array([shift_m, 0.0, 0.0]), np.array([1.0, 0, 0, 0]), turns=False))

        return say

    plan = [(0.4, lambda: Said(Wish.TAKE, "psm1")), (2.5, hold(0.0)), (2.6, hold(0.005)), (4.5, hold(0.005))]
    beside = Beside(laboratory, [*plan, (4.6, lambda: Said(Wish.RETURN, "psm1"))])
    assert _run_until_refused(laboratory, beside, there, 60.0)
    np.testing.assert_allclose(tips_m[2] - tips_m[0], [0.005, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(tips_m[1], tips_m[0], atol=1e-9)
    np.testing.assert_allclose(q(laboratory), FAR, atol=1e-6)
    names = [event["name"] for event in laboratory.log.events]
    assert "taken over" in names and "handed back" in names
    assert max(laboratory.robot.limit_use("psm1")) <= 1.001
