"""Allowed contacts happen, and the referee counts the others."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trio

from simulated import (
    ARM_MODELS,
    STATION,
    T_WORLD_BASE,
    Hand,
    ideal_laboratory,
    ideal_session,
    joints_at,
    scene_of,
    standing,
    world_with_arms,
)
from trocar.arms import fk, frames
from trocar.geometry import SE3, SO3
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.record import CollidingPair
from trocar.tasks.peg_transfer.scene import PegScene
from trocar.tasks.peg_transfer.shapes import Pegboard
from trocar.tasks.peg_transfer.world import PegWorld

PEG = 4
FOOT_M = Pegboard().pegs_m[PEG]
FAR = {"psm1": (0.085, 0.045, 0.080), "psm2": (-0.085, 0.045, 0.080)}


def touching(world, first: str, second: str) -> bool:
    """Return whether any contact joins a geom of one name to one of the other, by the beginnings of their names."""
    mujoco.mj_forward(world.model, world.data)
    for pair in world.data.contact.geom[: world.data.ncon]:
        names = [world.model.geom(int(g)).name for g in pair]
        for a, b in (names, names[::-1]):
            if a.startswith(first) and b.startswith(second):
                return True
    return False


def world_parked(*blocks):
    world = world_with_arms(*(blocks or (standing(0),)))
    for arm, place in FAR.items():
        world.place_arm(arm, joints_at(arm, place), 0.1)
    return world


def lay(world, block: int, T) -> None:
    address = world.model.joint(f"block{block}").qposadr[0]
    world.data.qpos[address : address + 7] = [*T.translation_m, *T.rotation.as_quaternion()]


def test_no_exclusion_hides_a_collision():
    model = world_parked().model
    assert model.nexclude == 0
    assert model.npair == 0


def test_parked_arms_touch_nothing():
    world = world_parked()
    assert not touching(world, "psm", "")


@pytest.mark.parametrize("arm", ["psm1", "psm2"])
def test_a_finger_meets_a_peg(arm):
    world = world_parked()
    world.place_arm(arm, joints_at(arm, FOOT_M + [0, 0, 0.012]), 0.0)
    assert touching(world, f"{arm}_finger", f"peg{PEG}")


@pytest.mark.parametrize(("arm", "aside_m"), [("psm1", -0.006), ("psm2", 0.004)])
def test_a_shaft_meets_a_peg(arm, aside_m):
    world = world_parked()
    world.place_arm(arm, joints_at(arm, FOOT_M + [aside_m, 0.0, -0.01]), 0.0)
    assert touching(world, f"{arm}_sleeve", f"peg{PEG}")


def test_the_arms_meet_each_other_with_fingers_and_shafts():
    world = world_parked()
    assert not touching(world, "psm1", "psm2")
    q2 = joints_at("psm2", (0.0, 0.0, 0.03))
    world.place_arm("psm2", q2, 0.0)
    for name, index in (("finger", 7), ("s", 4)):
        part_m = (T_WORLD_BASE["psm2"] @ frames(ARM_MODELS["psm2"], q2)[index]).translation_m
        up_the_shaft = (T_WORLD_BASE["psm2"].translation_m - part_m) * (0.2 if name == "s" else 0.0)
        world.place_arm("psm1", joints_at("psm1", part_m + up_the_shaft), 0.0)
        assert touching(world, "psm1_finger", f"psm2_{name}")


def test_a_block_meets_pegs_fingers_and_other_blocks():
    world = world_parked(standing(0), standing(5))
    through_its_wall = standing(PEG, (6e-3, 0.0), height_m=5e-3)
    lay(world, 0, through_its_wall)
    assert touching(world, "block0", f"peg{PEG}")
    lay(world, 1, standing(PEG, (12e-3, 0.0), height_m=5e-3))
    assert touching(world, "block0", "block1")
    lay(world, 0, standing(1))
    world.place_arm("psm1", joints_at("psm1", standing(1, (0.0, 5e-3)).translation_m - [0, 0, 4e-3]), 0.0)
    assert touching(world, "psm1_finger", "block0")


def test_the_hole_lets_its_peg_through():
    world = world_parked(standing(PEG, (1e-3, 1e-3), height_m=1e-3))
    assert not touching(world, "block0", f"peg{PEG}")


def collisions_of(script, *blocks, station=STATION):
    lab = ideal_laboratory(*(blocks or (standing(0),)), station=station)
    assert lab.run(lambda cell: script(lab), 30.0)
    return lab.record().collisions


def test_free_motion_counts_nothing():
    async def script(lab):
        hand = Hand(lab)
        for place in ((0.0, 0.0, 0.05), (-0.03, 0.02, 0.04), (0.03, -0.02, 0.04)):
            await hand.go(joints_at("psm1", place))

    assert collisions_of(script) == ()


def test_picking_and_lifting_a_block_cleanly_counts_nothing():
    async def script(lab):
        hand = Hand(lab)
        await hand.grasp(0)
        await hand.shift([0.0, 0.0, 0.03])

    assert collisions_of(script, standing(1)) == ()


def test_a_tip_driven_into_a_peg_counts_once_with_arm_peg_time_and_force():
    async def script(lab):
        hand = Hand(lab)
        await hand.go(joints_at("psm1", FOOT_M + [0.012, 0.0, 0.05]))
        await hand.shift([0.0, 0.0, -0.04])
        await hand.shift([-0.012, 0.0, 0.0])
        await hand.shift([0.012, 0.0, 0.0])

    (hit,) = collisions_of(script)
    assert (hit.arm, hit.what, hit.against) == ("psm1", "arm", f"peg {PEG}")
    assert hit.force_n > 1.0
    assert 0.0 < hit.time_s < hit.end_s
    assert np.linalg.norm(hit.p_world_m[:2] - FOOT_M[:2]) < 3e-3 and 0.0 < hit.p_world_m[2] < 0.021


def test_a_held_block_driven_into_a_peg_counts():
    async def script(lab):
        hand = Hand(lab)
        await hand.grasp(0)
        await hand.shift([0.0, 0.0, 0.018])
        await hand.shift([0.015, 0.0, 0.0])

    hits = collisions_of(script, standing(1))
    assert ("psm1", "held block", "peg 1") in {(hit.arm, hit.what, hit.against) for hit in hits}


def test_a_block_that_lies_against_its_peg_is_no_collision():
    async def script(lab):
        del lab
        await trio.sleep(0.5)

    assert collisions_of(script, standing(1, (2.0e-3, 0.0))) == ()


async def crash(lab):
    await Hand(lab, "psm2").go(joints_at("psm2", (0.0, 0.0, 0.06)))
    hand = Hand(lab, "psm1")
    await hand.go(joints_at("psm1", (0.03, 0.0, 0.06)))
    await hand.shift([-0.03, 0.0, 0.0])


def test_arms_driven_into_each_other_count():
    hits = collisions_of(crash, station=replace(STATION, min_distance_m=0.0))
    assert {(hit.arm, hit.against) for hit in hits} == {("psm1", "psm2")}


def test_the_top_of_a_peg_is_no_collision_and_its_side_is():
    world = PegWorld(scene_of(standing(0)))
    for normal, counts in (((0.0, 0.0, 1.0), False), ((0.6, 0.0, -0.8), False), ((1.0, 0.0, 0.0), True)):
        assert world.counts(CollidingPair("psm1", "held block", "peg 3"), np.array(normal)) == counts


# What the referee keeps for the score.


def test_a_block_is_held_while_both_fingers_touch_it():
    lab = ideal_laboratory(standing(1), standing(4))
    times = {}

    async def script(cell):
        hand = Hand(lab)
        await hand.grasp(0)
        times["gripped"] = cell.clock.now_s()
        await hand.shift([0.0, 0.0, 0.03])
        times["lifted"] = cell.clock.now_s()
        await cell.robot.jaw("psm1", 0.5)
        await trio.sleep(0.3)

    assert lab.run(script, 30.0)
    truth = lab.truth()
    first, last = (np.searchsorted(truth.times_s, times[name]) for name in ("gripped", "lifted"))
    assert truth.held[first : last + 1, 0].all()
    assert not truth.held[: first - 20, 0].any() and not truth.held[last + 20 :, 0].any()
    assert not truth.held[:, 1].any()


def test_truth_is_told_in_the_boards_frame_wherever_the_board_is():
    T_world_board = SE3.from_parts(SO3.axis("z", 0.05), [0.002, -0.0015, 0.0])
    T_board_blocks = SE3(np.stack([standing(1, (1e-3, 0.0), 0.3).matrix, standing(9).matrix]))
    scene = PegScene(T_world_board, T_world_board @ T_board_blocks)
    lab = SimLaboratory(ideal_session(), PegWorld(scene), np.random.default_rng(0))
    assert lab.run(lambda cell: cell.clock.sleep(0.05), 1.0)
    truth = lab.truth()
    assert truth.T_board_blocks.matrix.shape == (6, 2, 4, 4)
    off = truth.T_board_blocks.matrix - T_board_blocks.matrix
    assert np.abs(off[..., :3, 3]).max() < 0.2e-3 and np.abs(off[..., :3, :3]).max() < 0.01
    assert truth.pegs.tolist() == [[1, 9]] * 6
    for arm, tips in truth.p_board_tips.items():
        driven = T_WORLD_BASE[arm] @ fk(ARM_MODELS[arm], lab.world.joints(arm))
        assert np.abs(T_world_board.apply(tips[-1]) - driven.translation_m).max() < 1e-9
    assert np.array_equal(PegWorld(scene).arrays(lab.record())["T_world_board"], T_world_board.matrix)
