"""What a served arm makes of the commands of one tick."""

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.arms import fk
from trocar.crtk.convert import pose_of
from trocar.crtk.messages import Empty, JointState, PoseStamped
from trocar.crtk.server import CrtkServer
from trocar.lab import load_station
from trocar.lab.laboratory import build_cell
from trocar.lab.topics import Topics

STATION = load_station("peg-transfer")
PARK, JAW = STATION.arms["psm1"].park_q(), STATION.arms["psm1"].model.jaw
FAR = JointState(position=(PARK + [0.2, 0, 0, 0, 0, 0]).tolist())


def after(seconds, **commands):
    """Return a laboratory and the arm's state after it was sent these commands within one tick."""
    laboratory, bus, found = build_cell(STATION, seed=1), MemoryBus(), []
    server = CrtkServer(laboratory, Topics(), bus=bus)

    async def script(cell):
        async with trio.open_nursery() as nursery:
            for topic, message in commands.items():
                bus.publisher(f"/PSM1/{topic}", type(message)).send(message)
            nursery.start_soon(server.serve, cell)
            await cell.clock.sleep(seconds)
            found.append(server.arms["psm1"].operating)
            nursery.cancel_scope.cancel()

    laboratory.run(script, seconds + 1.0)
    return laboratory, found[0]


@pytest.mark.parametrize("topic", ["move_jp", "servo_jp"])
def test_an_arm_that_is_told_to_move_and_to_hold_within_one_tick_stays(topic):
    laboratory, operating = after(0.5, **{topic: FAR, "hold": Empty()})
    assert np.abs(laboratory.driver.setpoint("psm1").q - PARK).max() < 1e-5
    assert operating == ("ENABLED", True, False)


def test_an_arm_that_is_told_to_move_is_busy_and_arrives():
    _, operating = after(0.1, move_jp=FAR)
    assert operating == ("ENABLED", True, True)
    laboratory, operating = after(1.0, move_jp=FAR)
    assert np.abs(laboratory.driver.setpoint("psm1").q - FAR.position).max() < 1e-9
    assert operating == ("ENABLED", True, False)


def test_an_arm_that_is_told_a_pose_has_its_tip_there_in_the_registered_world():
    base = build_cell(STATION, seed=1).session.T_world_base_registered["psm1"]
    goal = pose_of(base @ fk(STATION.arms["psm1"].model, np.array(FAR.position)))
    laboratory, _ = after(1.0, move_cp=PoseStamped(pose=goal))
    assert np.abs(laboratory.driver.setpoint("psm1").q - FAR.position).max() < 1e-9


@pytest.mark.parametrize(
    ("topic", "asked_rad", "opening_rad"), [("jaw/move_jp", 9.0, JAW.upper), ("jaw/servo_jp", -9.0, JAW.lower)]
)
def test_jaws_go_no_further_than_their_range(topic, asked_rad, opening_rad):
    laboratory, _ = after((JAW.upper - JAW.lower) / JAW.max_speed + 0.1, **{topic: JointState(position=[asked_rad])})
    assert laboratory.driver.jaw_command_rad("psm1") == opening_rad
