"""The task: where blocks lie at first, and when a transfer counts."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated import standing
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.scene import Block, Pegboard
from trocar.scene.truth import Collision, Truth
from trocar.tasks import TASKS, PegTransfer
from trocar.tasks.peg_transfer import BOARD_SHIFT_M, BOARD_TURN_RAD, on_peg

TASK = PegTransfer()
SOURCE, TARGET = TASK.transfers[0]
OTHER = TASK.transfers[1][1]
BLOCK_RADIUS_M = Block().corner_m


def outline(pose: SE3) -> np.ndarray:
    """Return points (n, 2) on an upright block's outline in the board's plane."""
    angle = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    radius = Block().outer_radius_m(angle)
    rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)])
    return pose.apply(rim)[:, :2]


def overlap(a: SE3, b: SE3) -> bool:
    local = b.inverse().apply(np.column_stack([outline(a), np.full(180, Block().height_m)]))
    return bool((np.hypot(*local[:, :2].T) < Block().outer_radius_m(np.arctan2(local[:, 1], local[:, 0]))).any())


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_scene_can_be_played(seed):
    scene = TASK.scene(np.random.default_rng(seed))
    shift, turn = scene.T_world_board.translation_m, scene.T_world_board.rotation.log()
    assert np.abs(shift).max() <= BOARD_SHIFT_M and shift[2] == 0.0
    assert np.abs(turn[2]) <= BOARD_TURN_RAD and np.abs(turn[:2]).max() < 1e-12
    blocks = scene.T_world_board.inverse() @ scene.T_world_blocks
    assert [on_peg(blocks, peg) for peg in range(12)] == [*range(6), *[None] * 6]
    assert np.allclose(blocks.translation_m[:, 2], Block().height_m)
    for peg in range(6):
        hole = Block().hole_radius_m(np.linspace(0, 2 * np.pi, 90)).min()
        off = np.hypot(*(blocks[peg].translation_m - Pegboard().pegs_m[peg])[:2])
        assert off < hole - Pegboard().peg_radius_m
        assert not any(overlap(blocks[peg], blocks[k]) or overlap(blocks[k], blocks[peg]) for k in range(peg))


def test_scenes_differ_by_seed_alone():
    first, same, other = (TASK.scene(np.random.default_rng(seed)).T_world_blocks.matrix for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert np.abs(first - other).max() > 1e-3


def test_all_yaws_and_offsets_occur():
    rng = np.random.default_rng(0)
    scenes = [TASK.scene(rng) for _ in range(60)]
    blocks = SE3(np.concatenate([(s.T_world_board.inverse() @ s.T_world_blocks).matrix for s in scenes]))
    yaw = np.arctan2(blocks.matrix[:, 1, 0], blocks.matrix[:, 0, 0])
    assert np.histogram(yaw, bins=6, range=(-np.pi, np.pi))[0].min() > 30
    off = np.linalg.norm((blocks.translation_m - np.tile(Pegboard().pegs_m[:6], (60, 1)))[:, :2], axis=1)
    assert off.max() > 1.5e-3


def test_there_and_back_is_twelve_transfers_that_end_where_they_began():
    assert len(TASK.transfers) == 12
    lies = {peg: peg for peg in range(6)}
    for source, target in TASK.transfers:
        assert target not in lies
        lies[target] = lies.pop(source)
    assert lies == {peg: peg for peg in range(6)}


def test_the_budget_leaves_room_for_the_papers_slowest_robot():
    assert TASK.budget_s > 12 * 6.3


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_unknown_variants_are_named_with_the_choices(task):
    with pytest.raises(TrocarError, match=rf"'sideways'.*{task.variants[0]}"):
        task("sideways")


def scored(before: SE3, after: SE3, outcome: str = "DONE", collisions=(), source: int = SOURCE):
    """Return the score of one transfer between 1 s and 4 s, of a block that was here and then there."""
    poses = SE3(np.stack([np.stack([before.matrix, standing(5).matrix]), np.stack([after.matrix, standing(5).matrix])]))
    truth = Truth(np.array([0.0, 4.2]), poses, {}, tuple(collisions))
    note = {"name": "transfer", "time_s": 4.0, "start_s": 1.0, "source": source, "target": TARGET, "outcome": outcome}
    (score,) = TASK.score([{"name": "capture", "time_s": 1.1}, note], truth)
    return score


def turned_over(peg: int) -> SE3:
    return standing(peg) @ SE3.from_parts(SO3.axis("x", np.pi), [0.0, 0.0, Block().height_m])


def tilted(peg: int) -> SE3:
    return standing(peg) @ SE3.from_parts(SO3.axis("x", np.radians(15.0)))


def test_a_block_upright_on_its_target_succeeds():
    score = scored(standing(SOURCE), standing(TARGET, (1.5e-3, -1e-3), 2.0))
    assert score.attempted and score.succeeded and score.failure == ""
    assert (score.source, score.target, score.start_s, score.end_s) == (SOURCE, TARGET, 1.0, 4.0)


@pytest.mark.parametrize(
    "after",
    [
        standing(OTHER),
        standing(SOURCE),
        standing(TARGET, (6e-3, 0.0)),
        standing(TARGET, height_m=9e-3),
        tilted(TARGET),
        turned_over(TARGET),
    ],
    ids=["wrong peg", "still at its source", "beside its peg", "hung on the top", "tilted", "upside down"],
)
@pytest.mark.parametrize(("outcome", "failure"), [("DONE", "NOT_PLACED"), ("DROPPED", "DROPPED")])
def test_what_the_script_believes_does_not_count(after, outcome, failure):
    score = scored(standing(SOURCE), after, outcome)
    assert score.attempted and not score.succeeded
    assert score.failure == failure


def test_a_transfer_that_the_script_gave_up_but_that_is_done_counts():
    assert scored(standing(SOURCE), standing(TARGET), "DROPPED").succeeded


def test_an_empty_source_is_no_attempt():
    score = scored(standing(OTHER), standing(OTHER), "NO_BLOCK")
    assert not score.attempted and not score.succeeded
    assert score.failure == "NO_BLOCK"


def test_another_block_on_the_target_is_no_success():
    before = SE3(np.stack([standing(SOURCE).matrix, standing(TARGET).matrix]))
    after = SE3(np.stack([standing(OTHER).matrix, standing(TARGET).matrix]))
    truth = Truth(np.array([0.0, 4.2]), SE3(np.stack([before.matrix, after.matrix])), {}, ())
    note = {"name": "transfer", "time_s": 4.0, "start_s": 1.0, "source": SOURCE, "target": TARGET, "outcome": "DONE"}
    (score,) = TASK.score([note], truth)
    assert score.attempted and not score.succeeded


def test_a_block_may_still_fall_when_the_script_ends_a_transfer():
    """It is judged a moment later, and not by what comes after."""
    poses = [standing(SOURCE), standing(TARGET, height_m=12e-3), standing(TARGET), standing(OTHER)]
    truth = Truth(np.array([0.0, 3.9, 4.2, 9.0]), SE3(np.stack([[p.matrix] for p in poses])), {}, ())
    note = {"name": "transfer", "time_s": 4.0, "start_s": 1.0, "source": SOURCE, "target": TARGET, "outcome": "DONE"}
    (score,) = TASK.score([note], truth)
    assert score.succeeded


def test_collisions_do_not_fail_a_transfer():
    hit = Collision(2.0, "psm1", "arm", "peg 3", 4.0)
    assert scored(standing(SOURCE), standing(TARGET), collisions=[hit]).succeeded


def test_scoring_needs_nothing_of_the_simulator():
    """Truth is plain data: a recording of a real board would do."""
    stand_in = SimpleNamespace(blocks_at=lambda time_s: standing(SOURCE if time_s < 2 else TARGET)[None])
    note = {"name": "transfer", "time_s": 4.0, "start_s": 1.0, "source": SOURCE, "target": TARGET, "outcome": "DONE"}
    assert TASK.score([note], stand_in)[0].succeeded  # type: ignore[arg-type]
