"""Encoders, servos and the verbs of the simulated robot."""

import numpy as np
import pytest
import trio

from simulated import ARM_MODELS, PAPER, Hand, ideal_session, joints_at, scene_of, standing
from trocar.calibration.excitation import random_smooth_path
from trocar.errors import TrocarError
from trocar.motion import rest_to_rest
from trocar.sim.cell import SimulatedCell
from trocar.sim.robot import TICK_S
from trocar.sim.session import draw_session

SCENE = scene_of(standing(0))


def cell_of(session, seed: int = 0) -> SimulatedCell:
    return SimulatedCell(session, SCENE, np.random.default_rng(seed))


def test_encoders_read_the_command_while_the_joints_are_elsewhere():
    session = draw_session(np.random.default_rng(4))
    cell, seen = cell_of(session), {}
    goal = joints_at("psm1", (0.02, 0.01, 0.06))

    async def script():
        start = cell.robot.read("psm1").q
        motion = rest_to_rest(start, goal, PAPER)
        seen["execution"] = await cell.robot.move("psm1", motion)
        seen["duration_s"] = motion.duration_s
        await trio.sleep(0.5)
        seen["reading"] = cell.robot.read("psm1")
        seen["joints"] = cell.world.joints("psm1")

    assert cell.run(script, 20.0)
    assert np.abs(seen["reading"].q - goal).max() < 1e-12
    error = seen["joints"] - goal
    plant = session.plants["psm1"]
    widest = np.abs(plant.C) @ plant.radii + 5 * plant.noise_sd[3:]
    assert (np.abs(error[3:] - plant.offset - plant.K @ goal[3:]) < widest).all()
    assert np.abs(error[3:]).max() > 0.05
    assert np.abs(error[:3]).max() < 2e-3

    execution = seen["execution"]
    assert np.allclose(np.diff(execution.times_s), TICK_S)
    assert execution.times_s[-1] - execution.times_s[0] + TICK_S == pytest.approx(seen["duration_s"], abs=2 * TICK_S)
    assert np.array_equal(execution.commanded[:, :6], execution.measured[:, :6])
    assert np.abs(execution.commanded[-1, :6] - goal).max() < 1e-9


def test_at_rest_the_servos_add_nothing_to_the_cables_error():
    """What ``record_motion`` leaves out: below a mrad and a tenth of a mm at any place of its path."""
    cell, errors = cell_of(ideal_session()), []
    places = random_smooth_path(ARM_MODELS["psm1"], np.random.default_rng(2))[::200]

    async def script():
        hand = Hand(cell)
        for q in places:
            await hand.go(q)
            await trio.sleep(0.5)
            errors.append(cell.world.joints("psm1") - q)

    assert cell.run(script, 60.0)
    worst = np.abs(errors).max(axis=0)
    assert len(errors) > 5
    assert worst[[0, 1, 3, 4, 5]].max() < 1e-3
    assert worst[2] < 0.1e-3


def test_the_joints_follow_a_motion_at_the_papers_limits_closely():
    cell, errors = cell_of(ideal_session()), []
    goals = [joints_at("psm1", p, yaw) for p, yaw in (((0.03, -0.02, 0.05), 0.8), ((-0.03, 0.02, 0.05), -0.6))]

    async def watch():
        while True:
            await trio.sleep(TICK_S)
            errors.append(cell.world.joints("psm1") - cell.robot.read("psm1").q)

    async def script():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(watch)
            for q in goals:
                await Hand(cell).go(q)
            nursery.cancel_scope.cancel()

    assert cell.run(script, 20.0)
    worst = np.abs(errors).max(axis=0)
    assert worst[[0, 1]].max() < 5e-3
    assert worst[3:].max() < 20e-3
    assert worst[2] < 0.5e-3


def test_hold_stops_an_arm_at_once_and_wakes_its_script():
    cell, seen = cell_of(ideal_session()), {}
    goal = joints_at("psm1", (-0.04, 0.0, 0.06))

    async def script():
        motion = rest_to_rest(cell.robot.read("psm1").q, goal, PAPER)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, "psm1", motion)
            await trio.sleep(motion.duration_s / 2)
            cell.robot.hold("psm1")
        seen["at"] = cell.robot.read("psm1").q
        await trio.sleep(1.0)
        seen["later"] = cell.robot.read("psm1").q
        seen["joints"] = cell.world.joints("psm1")

    assert cell.run(script, 20.0)
    assert np.array_equal(seen["at"], seen["later"])
    assert np.abs(seen["at"] - goal).max() > 0.05
    assert np.abs(seen["joints"] - seen["at"]).max() < 1e-3


def test_the_jaw_arrives_at_its_opening_and_stalls_on_nothing():
    cell, seen = cell_of(ideal_session()), []

    async def script():
        for angle in (0.6, 0.2):
            await cell.robot.jaw("psm1", angle)
            seen.append(cell.robot.read("psm1").jaw_rad)

    assert cell.run(script, 5.0)
    assert np.allclose(seen, [0.6, 0.2], atol=0.02)


async def unknown_arm(cell):
    cell.robot.read("psm9")


async def jump(cell):
    start = cell.robot.read("psm1").q
    await cell.robot.move("psm1", rest_to_rest(start + 0.01, start, PAPER))


async def moving_already(cell):
    start = cell.robot.read("psm1").q
    async with trio.open_nursery() as nursery:
        nursery.start_soon(cell.robot.move, "psm2", rest_to_rest(cell.robot.read("psm2").q, start, PAPER))
        nursery.start_soon(cell.robot.move, "psm1", rest_to_rest(start, start + 0.1, PAPER))
        await trio.sleep(0.05)
        await cell.robot.move("psm1", rest_to_rest(start, start + 0.1, PAPER))


async def jaw_too_wide(cell):
    await cell.robot.jaw("psm1", 2.0)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        (unknown_arm, "psm9.*psm1, psm2"),
        (jump, "starts 0.0100"),
        (moving_already, "already moving"),
        (jaw_too_wide, "2.0000 rad is outside"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_sentence(script, words):
    cell = cell_of(ideal_session())
    with pytest.raises(TrocarError, match=words):
        cell.run(lambda: script(cell), 5.0)
