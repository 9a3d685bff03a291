"""What pages are told of a laboratory while it runs."""

import numpy as np
import pytest

import echo_arms
from trocar.eval.sight import RobotSight, SimSight, sight_of
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import LoopSettings
from trocar.lab import load_station
from trocar.sim.laboratory import simulated

STATION = load_station("peg-transfer")
RELAXED = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0)


@pytest.fixture
def robot():
    with HardwareLaboratory(STATION, echo_arms.connect, RELAXED) as laboratory:
        yield laboratory


def test_events_and_images_are_told_once():
    laboratory = simulated(STATION, np.random.default_rng(1))
    sight = sight_of(laboratory)
    assert isinstance(sight, SimSight)

    async def script(cell):
        cell.log.event("first")
        await cell.cameras["overhead"].capture()

    laboratory.run(script, 10.0)
    seen = sight.look()
    assert [event["name"] for event in seen.events] == ["first"] and seen.time_s == laboratory.now_s()
    assert list(sight.images()) == ["overhead"]
    assert not sight.look().events and not sight.images()


def test_of_real_arms_it_is_known_how_they_are_built_and_what_they_read(robot):
    sight = sight_of(robot)
    assert isinstance(sight, RobotSight) and not sight.scenery.T_world_base, "where they truly stand, nobody knows"
    seen = sight.look()
    assert not [name for name in seen.arrays if name.startswith(("true_", "body_"))]
    replay = sight.scenery.shown("robot", np.array([seen.time_s]), seen.arrays)
    assert {solid.body for solid in replay.solids} <= set(replay.T_world_body), "each has a place"
    tip_m = replay.tools["psm1"].p_world_driven_m[0]
    q = seen.arrays["measured_psm1"][0, :6]
    np.testing.assert_allclose(q, robot.cell.robot.read("psm1").q)
    assert np.linalg.norm(tip_m - replay.T_world_body["psm1_link6"].translation_m[0]) < 0.02
