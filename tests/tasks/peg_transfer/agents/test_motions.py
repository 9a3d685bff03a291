"""Where the motions of one arm lead: straight up and down, the tool turned or the wrist still."""

import numpy as np
import pytest

from simulated import ideal_laboratory, standing
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.agents import motions as module
from trocar.tasks.peg_transfer.agents.motions import end_of
from trocar.tasks.peg_transfer.agents.unilateral import Unilateral
from trocar.tasks.peg_transfer.grasps import FINGER_ROOM_M, Grasp, choose_grasp
from two_armed import briefed

SOURCE, TARGET = 0, 6
BLOCK_AT = standing(SOURCE, (0.9e-3, -0.8e-3), 0.7)
HEIGHT_M = 36e-3


def motions_of(fixed_wrist):
    agent = Unilateral(briefed(ideal_laboratory(BLOCK_AT), settings=Settings(fixed_wrist=fixed_wrist)))
    agent.arm.table.blocks[SOURCE] = BLOCK_AT
    return agent.arm, agent.arm.motions


def grasped(arm, motions):
    """Return the joints at a block, and the block in the jaws then."""
    grasp = choose_grasp(arm.model, motions.T_base_board, BLOCK_AT, arm.table.board, arm.table.block)
    assert isinstance(grasp, Grasp)
    q = end_of(motions.approach(arm.hand.q, grasp, SOURCE).path)
    return q, motions.gripped(q, BLOCK_AT)


@pytest.mark.parametrize("fixed_wrist", [False, True])
def test_straight_above_is_above_and_either_the_tool_or_the_wrist_keeps_still(fixed_wrist):
    arm, motions = motions_of(fixed_wrist)
    q, _ = grasped(arm, motions)
    above = motions.above(q, HEIGHT_M)
    before, after = motions.tip(q), motions.tip(above)
    np.testing.assert_allclose(after.translation_m, [*before.translation_m[:2], HEIGHT_M], atol=1e-8)
    turned_rad = np.linalg.norm((before.rotation.inverse() @ after.rotation).log())
    if fixed_wrist:
        np.testing.assert_array_equal(above[3:], q[3:])
        assert 0.02 < turned_rad < 0.15
    else:
        assert turned_rad < 1e-8 and np.abs(above[3:] - q[3:]).max() > 0.02


def test_a_wrist_that_cannot_keep_still_turns(monkeypatch):
    arm, motions = motions_of(True)
    q, _ = grasped(arm, motions)

    def unreachable(*_):
        raise OutOfReach("joint 'insertion' = 0.2402 m is outside")

    monkeypatch.setattr(module, "ik_with_fixed_wrist", unreachable)
    before, after = motions.tip(q), motions.tip(motions.above(q, HEIGHT_M))
    assert np.linalg.norm((before.rotation.inverse() @ after.rotation).log()) < 1e-8


def test_a_lifted_block_has_the_peg_in_the_middle_of_what_has_still_to_pass_it():
    arm, motions = motions_of(True)
    q, T_tip_block = grasped(arm, motions)
    carriage = motions.carriage(q, T_tip_block, SOURCE, TARGET)
    assert carriage is not None
    path = carriage.path
    for peg, index, foot in ((SOURCE, 1, q), (TARGET, -2, end_of(path))):
        over = path.trajectory(path.waypoint_times_s[index])
        np.testing.assert_allclose(over[3:], foot[3:], atol=1e-9)
        low = (motions.tip(over) @ T_tip_block).apply([0.0, 0.0, arm.table.block.height_m])
        np.testing.assert_allclose(low[:2], arm.table.board.pegs_m[peg, :2], atol=2e-5)
        assert low[2] > arm.table.board.peg_height_m


def test_a_block_is_lowered_to_where_the_inner_finger_has_room():
    arm, motions = motions_of(True)
    q, T_tip_block = grasped(arm, motions)
    over = motions.clear(q, T_tip_block, TARGET, HEIGHT_M)
    down = end_of(motions.lowering(over, T_tip_block, TARGET))
    T_board_block, foot_m = motions.tip(down) @ T_tip_block, arm.table.board.pegs_m[TARGET, :2]
    half = T_board_block.apply([0.0, 0.0, 0.5 * arm.table.block.height_m])[:2]
    wall = motions.tip(down).translation_m[:2] - T_board_block.translation_m[:2]
    assert np.linalg.norm(half - foot_m) == pytest.approx(FINGER_ROOM_M, abs=2e-5)
    assert (half - foot_m) @ wall > 0.9 * FINGER_ROOM_M * np.linalg.norm(wall), "towards the wall that is held"


@pytest.mark.parametrize("fixed_wrist", [False, True])
def test_a_block_that_is_offered_is_first_lifted_off_its_peg(fixed_wrist):
    arm, motions = motions_of(fixed_wrist)
    q, T_tip_block = grasped(arm, motions)
    offered = SE3.from_parts(SO3.axis("z", 0.4), [0.0, 0.0, 0.05])
    path = motions.offering(q, T_tip_block, SOURCE, offered)
    np.testing.assert_allclose(motions.tip(end_of(path)).matrix, offered.matrix, atol=1e-8)
    lifted = path.trajectory(path.waypoint_times_s[1])
    low = (motions.tip(lifted) @ T_tip_block).apply([0.0, 0.0, arm.table.block.height_m])
    assert low[2] > arm.table.board.peg_height_m
    assert np.allclose(lifted[3:], q[3:], atol=1e-9) == fixed_wrist
    end = motions.tip(end_of(path)) @ T_tip_block
    np.testing.assert_allclose(end.matrix[:3, 2], [0, 0, -1], atol=1e-6)


def test_a_block_is_lowered_by_how_it_hangs_not_by_how_it_was_believed_to():
    arm, motions = motions_of(True)
    q, T_tip_block = grasped(arm, motions)
    carriage = motions.carriage(q, T_tip_block, SOURCE, TARGET)
    assert carriage is not None
    over = carriage.path.trajectory(carriage.path.waypoint_times_s[-2])
    hangs = SE3.from_parts(SO3.exp(np.array([0.04, -0.03, 0.0])), [0.5e-3, -0.9e-3, 0.4e-3]) @ T_tip_block
    path, block = motions.lowering(over, hangs, TARGET), arm.table.block
    aside, down = (path.trajectory(path.waypoint_times_s[index]) for index in (1, 2))
    foot_m = arm.table.board.pegs_m[TARGET, :2]
    for joints, part, off_m in ((aside, 1.0, 0.0), (down, 0.5, FINGER_ROOM_M)):
        hole = (motions.tip(joints) @ hangs).apply([0.0, 0.0, part * block.height_m])
        assert np.linalg.norm(hole[:2] - foot_m) == pytest.approx(off_m, abs=2e-5)
        np.testing.assert_allclose(joints[3:], over[3:], atol=1e-9)
    assert motions.tip(aside).translation_m[2] == pytest.approx(motions.tip(over).translation_m[2], abs=1e-6)
    low_end = (motions.tip(down) @ hangs).apply([0.0, 0.0, block.height_m])
    assert low_end[2] == pytest.approx(arm.settings.drop_m, abs=5e-5)


def test_over_a_block_it_goes_down_without_turning_a_wrist_that_is_a_little_off():
    arm, motions = motions_of(True)
    q, _ = grasped(arm, motions)
    grasp = choose_grasp(arm.model, motions.T_base_board, BLOCK_AT, arm.table.board, arm.table.block)
    assert isinstance(grasp, Grasp)
    over = motions.above(q, 22e-3)
    over[3:] += [0.02, -0.03, 0.02]
    down = end_of(motions.approach(over, grasp, SOURCE).path)
    np.testing.assert_allclose(down[3:], over[3:], atol=1e-9)
    np.testing.assert_allclose(motions.tip(down).translation_m, grasp.T_board_tip.translation_m, atol=1e-8)
    over[3:] += [0.0, 0.2, 0.0]
    down = end_of(motions.approach(over, grasp, SOURCE).path)
    np.testing.assert_allclose(motions.tip(down).matrix, grasp.T_board_tip.matrix, atol=1e-8)
