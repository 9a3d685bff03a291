"""A block is held by friction alone: what that means over twenty seconds, in motion, and without friction."""

import mujoco
import numpy as np
import pytest
import trio

from simulated import TWICE, Hand, blocks_of, ideal_laboratory, joints_at, standing, world_with_arms
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.spec import Surface

LIFT_M = 0.03
BLOCK = 0


def laboratory_with_a_block(surface: Surface | None = None) -> SimLaboratory:
    """Return a laboratory whose guard lets the arms go twice as fast as the paper's."""
    return ideal_laboratory(standing(1, (0.5e-3, -0.8e-3), 0.4), limits=TWICE, surface=surface)


def between_the_fingers(laboratory: SimLaboratory) -> int:
    """Return how many contacts the block has with the fingers."""
    world = laboratory.world
    pairs = world.data.contact.geom[: world.data.ncon]
    fingers = np.isin(pairs, world.arms["psm1"].fingers).any(1)
    return int((fingers & np.isin(pairs, world.geoms(f"block{BLOCK}")).any(1)).sum())


def height_m(laboratory: SimLaboratory) -> float:
    return float(blocks_of(laboratory.world)[BLOCK].translation_m[2])


def apart(first, second) -> tuple[float, float]:
    """Return by how much a pose in the tip changed: m and degrees."""
    change = first.inverse() @ second
    shift = second.translation_m - first.translation_m
    return float(np.linalg.norm(shift)), float(np.degrees(np.linalg.norm(change.rotation.log())))


@pytest.fixture(scope="module")
def held():
    """What happened to a block that was lifted, held for 20 s, whirled about, and let go."""
    lab = laboratory_with_a_block()
    hand, seen = Hand(lab), {}

    async def script(cell):
        await hand.grasp(BLOCK)
        before = height_m(lab)
        await hand.shift([0.0, 0.0, LIFT_M])
        seen["lifted_m"] = height_m(lab) - before
        await trio.sleep(1.0)
        seen["first"] = hand.T_tip_block(BLOCK)
        touches, awake = [], []
        for _ in range(19):
            await trio.sleep(1.0)
            touches.append(between_the_fingers(lab))
            awake.append(int(lab.world.data.body_awake[lab.world.model.body(f"block{BLOCK}").id]))
        seen["touches"], seen["awake"] = touches, awake
        seen["last"] = hand.T_tip_block(BLOCK)
        there = hand.q
        for p_world, yaw in (((0.03, -0.02, 0.06), 0.6), ((-0.04, 0.02, 0.05), -0.5), ((0.03, 0.02, 0.05), 0.9)):
            await hand.go(joints_at("psm1", p_world, yaw), TWICE)
        await hand.go(there, TWICE)
        seen["use"] = lab.driver.limit_use("psm1")
        await trio.sleep(0.3)
        seen["whirled"], seen["whirled_touches"] = hand.T_tip_block(BLOCK), between_the_fingers(lab)
        seen["whirled_m"] = height_m(lab)
        await cell.robot.jaw("psm1", 0.5)
        await trio.sleep(0.5)
        seen["released_m"], seen["released_touches"] = height_m(lab), between_the_fingers(lab)

    assert lab.run(script, 60.0)
    return seen


def test_the_block_comes_up_with_the_jaws(held):
    assert held["lifted_m"] == pytest.approx(LIFT_M, abs=1.5e-3)


def test_twenty_seconds_of_holding_creep_less_than_half_a_millimetre(held):
    shift_m, turn_deg = apart(held["first"], held["last"])
    assert shift_m < 0.5e-3
    assert turn_deg < 3.0


def test_the_block_is_held_by_contacts_that_are_computed_all_the_time(held):
    assert min(held["touches"]) > 0
    assert min(held["awake"]) == 1


def test_twice_the_papers_acceleration_does_not_shake_it_loose(held):
    assert held["use"][1] == pytest.approx(1.0, abs=1e-3), "it was not whirled as fast as that"
    shift_m, turn_deg = apart(held["last"], held["whirled"])
    assert held["whirled_touches"] > 0
    assert shift_m < 3e-3
    assert turn_deg < 20.0


def test_opening_the_jaws_drops_it(held):
    assert held["whirled_m"] - held["released_m"] > 0.5 * LIFT_M
    assert held["released_touches"] == 0


def test_without_friction_the_jaws_come_up_empty():
    slippery = Surface(jaw_friction=0.01, abs_friction=0.01)
    lab = laboratory_with_a_block(slippery)
    hand, seen = Hand(lab), {}

    async def script(cell):
        del cell
        await hand.grasp(BLOCK)
        before = height_m(lab)
        await hand.shift([0.0, 0.0, LIFT_M])
        await trio.sleep(0.5)
        seen["lifted_m"] = height_m(lab) - before

    assert lab.run(script, 20.0)
    assert seen["lifted_m"] < 0.2 * LIFT_M


def test_nothing_in_the_model_glues_a_block_to_an_arm():
    model = world_with_arms(standing(0)).model
    assert (model.eq_type == mujoco.mjtEq.mjEQ_JOINT).all()
    joints = {model.joint(j).name for pair in zip(model.eq_obj1id, model.eq_obj2id, strict=True) for j in pair}
    assert joints == {f"{arm}_jaw_{side}" for arm in ("psm1", "psm2") for side in ("left", "right")}
    assert model.ntendon == 0
    assert not (model.body_gravcomp[[model.body("block0").id]] > 0).any()
