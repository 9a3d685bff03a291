"""Encoders, servos and the verbs of the simulated robot."""

import numpy as np
import pytest
import trio

from simulated import ARM_MODELS, PAPER, STATION, Hand, ideal_laboratory, ideal_session, joints_at, scene_of, standing
from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.lab.session import draw_session
from trocar.motion import rest_to_rest
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.peg_transfer.world import PegWorld


def laboratory_of(session, seed: int = 0) -> SimLaboratory:
    return SimLaboratory(session, PegWorld(scene_of(standing(0))), np.random.default_rng(seed))


def test_encoders_read_the_command_while_the_joints_are_elsewhere():
    session = draw_session(STATION, np.random.default_rng(4))
    laboratory, seen = laboratory_of(session), {}
    goal = joints_at("psm1", (0.02, 0.01, 0.06))

    async def script(cell):
        motion = rest_to_rest(cell.robot.setpoint("psm1").q, goal, PAPER)
        seen["execution"] = (await cell.robot.move({"psm1": motion}))["psm1"]
        seen["duration_s"] = motion.duration_s
        await trio.sleep(0.5)
        seen["reading"] = cell.robot.read("psm1")
        seen["joints"] = laboratory.world.joints("psm1")

    assert laboratory.run(script, 20.0)
    assert np.abs(seen["reading"].q - goal).max() < 1e-12
    error = seen["joints"] - goal
    plant = session.transmissions["psm1"].plant
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
    laboratory, errors = laboratory_of(ideal_session()), []
    places = random_smooth_path(ARM_MODELS["psm1"], np.random.default_rng(2), box=PSM1_BOX)[::200]

    async def script(cell):
        del cell
        hand = Hand(laboratory)
        for q in places:
            await hand.go(q)
            await trio.sleep(0.5)
            errors.append(laboratory.world.joints("psm1") - q)

    assert laboratory.run(script, 60.0)
    worst = np.abs(errors).max(axis=0)
    assert len(errors) > 5
    assert worst[[0, 1, 3, 4, 5]].max() < 1e-3
    assert worst[2] < 0.1e-3


def test_fingers_that_are_pressed_together_stop_each_other():
    """However hard the drive pulls: what their encoder says then is their zero."""
    laboratory = ideal_laboratory(standing(1))

    async def script(cell):
        await cell.robot.jaw("psm1", -0.17)
        await cell.clock.sleep(0.3)

    assert laboratory.run(script, 10.0)
    assert abs(laboratory.world.jaw_rad("psm1")) < 1e-3


def test_jaws_that_stall_on_a_block_read_what_they_hold():
    laboratory = ideal_laboratory(standing(1))

    async def script(cell):
        await Hand(laboratory).grasp(0)
        return cell.robot.read("psm1").jaw_rad

    assert laboratory.run(script, 20.0)
    commanded, measured = (laboratory.recorder.joints(kind)["psm1"][-1, 6] for kind in ("true", "measured"))
    assert measured == pytest.approx(commanded) and 0.08 < measured < 0.35
