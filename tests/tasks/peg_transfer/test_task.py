"""The task: where blocks are at the start, and what is to be done with them."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trocar
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.lab import load_station, station_text
from trocar.lab.flaws import LEVELS, Difficulty
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.goals import GOALS
from trocar.tasks.peg_transfer.report import PAPER
from trocar.tasks.peg_transfer.scene import BOARD_SHIFT_M, BOARD_TURN_RAD
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.tasks.peg_transfer.truth import pegs_under

TASK = PegTransfer()
STATION = load_station("peg-transfer")


def scene(rng, station=STATION):
    return TASK.scene(rng, station)


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
@given(seed=st.integers(0, 2**32 - 1), level=st.sampled_from(LEVELS))
def test_every_scene_can_be_played(seed, level):
    laid = scene(np.random.default_rng(seed), replace(STATION, difficulty=Difficulty.of(level)))
    shift, turn = laid.T_world_board.translation_m, laid.T_world_board.rotation.log()
    assert np.abs(shift).max() <= BOARD_SHIFT_M and shift[2] == 0.0
    assert np.abs(turn[2]) <= BOARD_TURN_RAD and np.abs(turn[:2]).max() < 1e-12
    blocks = laid.T_world_board.inverse() @ laid.T_world_blocks
    assert pegs_under(blocks, laid.board, laid.block).tolist() == [*range(6)]
    assert np.allclose(blocks.translation_m[:, 2], laid.block.height_m)
    for peg in range(6):
        hole = laid.block.hole_radius_m(np.linspace(0, 2 * np.pi, 90)).min()
        off = np.hypot(*(blocks[peg].translation_m - laid.board.pegs_m[peg])[:2])
        assert off < hole - laid.board.peg_radius_m
        assert not any(overlap(blocks[peg], blocks[k]) or overlap(blocks[k], blocks[peg]) for k in range(peg))


def test_scenes_differ_by_seed_alone():
    first, same, other = (scene(np.random.default_rng(seed)).T_world_blocks.matrix for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert np.abs(first - other).max() > 1e-3


def test_all_yaws_and_offsets_occur():
    rng = np.random.default_rng(0)
    scenes = [scene(rng) for _ in range(60)]
    blocks = SE3(np.concatenate([(s.T_world_board.inverse() @ s.T_world_blocks).matrix for s in scenes]))
    yaw = np.arctan2(blocks.matrix[:, 1, 0], blocks.matrix[:, 0, 0])
    assert np.histogram(yaw, bins=6, range=(-np.pi, np.pi))[0].min() > 30
    off = np.linalg.norm((blocks.translation_m - np.tile(Pegboard().pegs_m[:6], (60, 1)))[:, :2], axis=1)
    assert off.max() > 1.5e-3


def test_the_board_stands_where_the_station_has_it():
    moved = SE3.from_parts(SO3.axis("z", 0.4), [0.01, -0.02, 0.003])
    elsewhere = replace(STATION, T_world_fixture={"board": moved})
    here, there = (scene(np.random.default_rng(3), station) for station in (STATION, elsewhere))
    assert np.allclose(there.T_world_board.matrix, (moved @ here.T_world_board).matrix)
    assert np.allclose(there.T_world_blocks.matrix, (moved @ here.T_world_blocks).matrix)


def test_the_budget_leaves_room_for_the_papers_slowest_robot():
    assert TASK.budget_s > 12 * 6.3


def test_an_unknown_variant_is_refused_in_a_sentence():
    words = "variant of peg-transfer 'sideways' is unknown; choose one of unilateral, bilateral, handover"
    with pytest.raises(TrocarError, match=words):
        PegTransfer(variant="sideways")


def test_the_options_are_what_tells_one_run_from_another():
    assert json.loads(json.dumps(TASK.options())) == {"variant": "unilateral", "transfers": 12, "budget_s": 180.0}


@pytest.mark.parametrize(
    ("name", "how", "changed"),
    [
        ("calibrated", (True, False, "spline"), {"fixed_wrist": True}),
        ("uncalibrated", (False, False, "spline"), {}),
        (
            "adaptive",
            (False, True, "spline"),
            {"teaching_looks": 36, "fixed_wrist": True, "looks_before_placing": True},
        ),
        ("optimized", (True, False, "sqp"), {"planning_budget_s": 0.4, "fixed_wrist": True}),
        (
            "best",
            (True, False, "optimal"),
            {"perception_budget_s": 0.085, "planning_budget_s": 0.06, "fixed_wrist": True, "learns_offset": True}
            | {
                "retries": 2,
                "rounds": 3,
                "settle_s": 0.02,
                "waits_for_jaws": False,
                "jaw_grip_rad": 0.0,
                "jaw_empty_rad": 0.18,
            },
        ),
    ],
)
def test_the_methods_differ_by_calibration_planner_and_a_few_settings(name, how, changed):
    method = PegTransfer.methods[name]
    assert (method.calibrated, method.learns, method.planner) == how and method.perception == "depth"
    own, usual = asdict(method.make_settings()), asdict(Settings())
    assert {key: value for key, value in own.items() if key != "limits" and value != usual[key]} == changed


def test_fewer_transfers_are_the_first_ones():
    for variant, transfers in GOALS.items():
        assert PegTransfer(variant=variant).goals() == transfers
        assert PegTransfer(variant=variant, transfers=5).goals() == transfers[:5]


@pytest.mark.parametrize(("variant", "arms"), [("unilateral", 1), ("bilateral", 2), ("handover", 2)])
def test_a_variant_says_how_many_arms_work(variant, arms):
    task = PegTransfer(variant=variant)
    assert task.working_arms(STATION) == ("psm1", "psm2")[:arms]
    assert task.nominal().variant == variant and variant in PAPER
    alone = replace(STATION, arms={"psm1": STATION.arms["psm1"]})
    if arms == 1:
        assert task.at(alone) is alone
    else:
        with pytest.raises(TrocarError, match=rf"has one arm.*--variant {variant} needs two"):
            task.at(alone)


def test_prints_are_off_by_as_much_as_the_flaw_says_and_only_then():
    def boards(*flaws):
        station = replace(STATION, difficulty=Difficulty.of("mild", flaws))
        return [scene(np.random.default_rng(seed), station) for seed in range(60)]

    assert all(laid.board == Pegboard(pegs_off_m=((0.0, 0.0),) * 12) and laid.block == Block() for laid in boards())
    off = boards("print=0.1mm")
    pegs = np.array([laid.board.pegs_off_m for laid in off])
    assert pegs.std() == pytest.approx(0.1e-3, rel=0.1) and abs(pegs.mean()) < 0.02e-3
    np.testing.assert_allclose(off[0].board.pegs_m[:, :2] - Pegboard().pegs_m[:, :2], pegs[0], atol=1e-12)
    sizes = [
        (
            laid.board.peg_radius_m - Pegboard().peg_radius_m,
            laid.board.peg_height_m - Pegboard().peg_height_m,
            laid.block.side_m - Block().side_m,
            laid.block.corner_m - Block().corner_m,
            laid.block.height_m - Block().height_m,
            laid.block.hole_wider_m,
        )
        for laid in off
    ]
    np.testing.assert_allclose(np.std(sizes, axis=0), 0.1e-3, rtol=0.35)
    with_print, without = (laid.T_world_board.matrix for laid in (off[5], boards()[5]))
    np.testing.assert_array_equal(with_print, without, "all else is drawn as it was")


def test_what_an_agent_knows_is_the_drawing():
    assert TASK.nominal().board == Pegboard() and TASK.nominal().block == Block()


def test_the_worst_print_can_still_be_laid_down():
    station = replace(STATION, difficulty=Difficulty.of("mild", ["print=5mm"]))
    for seed in range(20):
        laid = scene(np.random.default_rng(seed), station)
        blocks = laid.T_world_board.inverse() @ laid.T_world_blocks
        assert pegs_under(blocks, laid.board, laid.block).tolist() == [*range(6)]


def test_a_block_arrives_at_a_quarter_of_the_usual_speed_too(tmp_path):
    """Planned faster than the arm may move, it went astray: compensated commands left its path to keep the limits."""
    slow = tmp_path / "slow.toml"
    slow.write_text(station_text("peg-transfer").replace('limits = "paper"', 'limits = "paper"\nspeed = 0.25'))
    how = {"method": "best", "calibration": "joints", "difficulty": "mild", "transfers": 1, "seed": 11}
    (trial,) = trocar.run("peg-transfer", station=str(slow), out=tmp_path / "run", **how)
    assert trial.scores[0]["succeeded"], trial.scores[0]
    assert max(max(shares) for shares in trial.command_limit_use.values()) <= 1 + 1e-6
    assert trial.duration_s > 12.0, "as slow as asked"
