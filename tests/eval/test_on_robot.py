"""A script on real arms ends at the fault after which an arm refuses to move, and its record has all that was sent."""

from functools import partial

import numpy as np
import pytest

import echo_arms
from driven import HOME
from trocar.eval.on_robot import _run_until_refused
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import ArmFault, Fault, LoopSettings
from trocar.lab import load_station
from trocar.motion import rest_to_rest
from trocar.testing.hardware import faulty

pytestmark = pytest.mark.realtime
STATION = load_station("peg-transfer")
LIMITS = STATION.arms["psm1"].limits
RELAXED = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0)
FAR = HOME + np.array([0.6, 0.4, -0.04, 1.5, 1.0, -1.0])


async def stubborn(cell):
    """Move back and forth, whatever comes of it."""
    while True:
        for goal in (FAR, HOME):
            start = cell.robot.setpoint("psm1").q
            await cell.robot.move({"psm1": rest_to_rest(start, goal, LIMITS)})
            await cell.clock.sleep(0.01)


@pytest.mark.parametrize("after", [0, 8])
def test_a_script_that_goes_on_after_a_fault_is_ended_by_it(after):
    """Also if it was there in the first tick, while the arms were being connected."""
    connect = partial(faulty, connect=echo_arms.connect, plant="nan", after=after)
    with HardwareLaboratory(STATION, connect, RELAXED) as laboratory, pytest.raises(ArmFault) as found:
        _run_until_refused(laboratory, None, stubborn, 20.0)
    assert found.value.fault is Fault.INVALID
    assert Fault.INVALID.name.lower() in [event["fault"] for event in laboratory.log.events if event["name"] == "fault"]


def test_what_a_script_makes_of_a_fault_is_not_the_reason():
    async def confused(cell):
        (result,) = (await cell.robot.move({"psm1": rest_to_rest(HOME, FAR, LIMITS)})).values()
        raise ValueError(f"ended {result.ended}")

    connect = partial(faulty, connect=echo_arms.connect, plant="nan")
    with HardwareLaboratory(STATION, connect, RELAXED) as laboratory, pytest.raises(ArmFault):
        _run_until_refused(laboratory, None, confused, 20.0)


def test_a_script_whose_arms_are_well_has_its_time(tmp_path):
    """What is kept of it ends with what its arm was sent last, and there it is at rest."""
    log = tmp_path / "sent"
    with HardwareLaboratory(STATION, partial(echo_arms.connect, log=log), RELAXED) as laboratory:
        assert not _run_until_refused(laboratory, None, stubborn, 0.5)
    kept = laboratory.record.arrays(laboratory.robot.origin_s, 0.03)["commanded_psm1"]
    sent = np.loadtxt(log)
    assert np.array_equal(kept[-1, :6], sent[-1, 1:7]) and not sent[-1, 7:13].any()
    assert np.abs(np.diff(kept[:, :6], axis=0)).max() > 1e-3
