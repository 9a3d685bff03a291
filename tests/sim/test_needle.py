"""A needle is held by friction, by the phantom's drag, or not at all."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from simulated import ARM_MODELS, ideal_session
from trocar.arms import MOTION_LIMITS, fk
from trocar.motion import rest_to_rest
from trocar.sim.cell import SimulatedCell
from trocar.sim.mjcf import CellModel, build_mjcf
from trocar.sim.needle import Tissue
from trocar.sim.sensor_flaws import SensorFlaws
from trocar.tasks import CircleSutures

TASK = CircleSutures(sutures=1)
SCENE = TASK.scene(np.random.default_rng(0))
CLOSED, OPEN = -0.17, 0.4


@pytest.fixture
def cell():
    return SimulatedCell(ideal_session(TASK.T_world_base), SCENE, np.random.default_rng(0), SensorFlaws.none())


def in_jaws(cell):
    """Return ``T_tip_needle`` as it truly is."""
    T_world_tip = TASK.T_world_base["psm1"] @ fk(ARM_MODELS["psm1"], cell.world.joints("psm1"))
    return T_world_tip.inverse() @ needle(cell)


def needle(cell):
    return (SCENE.T_world_circle @ cell.referee.truth().T_circle_needle)[-1]


async def load(cell):
    await cell.robot.jaw("psm1", OPEN)
    await cell.assistant.load("psm1")
    await cell.robot.jaw("psm1", CLOSED)


def test_no_weld_holds_it():
    root = ET.fromstring(build_mjcf(CellModel(SCENE, {"psm1": ARM_MODELS["psm1"]}, TASK.T_world_base)))
    assert [e.tag for e in root.find("equality")] == ["joint"]  # the fingers' coupling
    assert root.find("contact") is None


def test_jaws_hold_a_loaded_needle_through_fast_motions_by_friction(cell):
    shift = np.array([0.2, 0.2, 0.03, 0.8, 0.5, -0.5])

    async def script():
        await load(cell)
        for sign in (1, -1, 1):
            q = cell.robot.read("psm1").q
            await cell.robot.move("psm1", rest_to_rest(q, q + sign * shift, MOTION_LIMITS["dvrk"]))

    assert cell.run(script, 60.0)
    moved = (SCENE.T_tip_needle.inverse() @ in_jaws(cell)).log()
    assert np.linalg.norm(in_jaws(cell).translation_m - SCENE.T_tip_needle.translation_m) < 0.5e-3
    assert np.linalg.norm(moved[3:]) < np.radians(5.0)


def test_open_jaws_let_it_fall(cell):
    async def script():
        await load(cell)
        await cell.robot.jaw("psm1", OPEN)
        await cell.robot.move("psm1", rest_to_rest(q := cell.robot.read("psm1").q, q + [0, 0, 0.02, 0, 0, 0], LIMITS))

    assert cell.run(script, 60.0)
    lost = in_jaws(cell).translation_m - SCENE.T_tip_needle.translation_m
    assert np.linalg.norm(lost) > 2e-3


LIMITS = MOTION_LIMITS["dvrk"]


def test_a_person_holds_it_still_until_both_fingers_press(cell):
    held = cell.world.effects[0].__self__

    async def script():
        await cell.robot.jaw("psm1", OPEN)
        await cell.assistant.load("psm1")
        await cell.robot.jaw("psm1", 0.2)  # straddles the wire without touching it
        assert held.in_hand
        await cell.robot.jaw("psm1", CLOSED)
        assert not held.in_hand

    assert cell.run(script, 60.0)


def test_drag_holds_it_only_below_the_surface(cell):
    held = cell.world.effects[0].__self__
    free = slice(cell.world.model.joint("needle").dofadr[0], None)
    for height_m, drag in ((0.02, 0.0), (-0.001, Tissue().drag)):
        held.in_hand = False
        at = SCENE.T_world_circle.matrix.copy()
        at[2, 3] += height_m
        cell.world.data.qpos[held._qpos][:3] = at[:3, 3]
        cell.world.data.qvel[:] = 0.0
        held.act()
        assert cell.world.model.dof_damping[free][0] == drag


def test_the_phantom_bears_its_weight(cell):
    held = cell.world.effects[0].__self__
    held.in_hand = False
    inside = SCENE.T_world_circle.apply([0.0, 0.0, -0.001])
    cell.world.data.qpos[held._qpos] = [*inside, 1.0, 0.0, 0.0, 0.0]
    cell.world.data.qvel[:] = 0.0
    before = held.T_world_needle.translation_m
    for _ in range(500):
        cell.world.step(2)
    assert np.linalg.norm(held.T_world_needle.translation_m - before) < 1e-6
