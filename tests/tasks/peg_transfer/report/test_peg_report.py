"""What a report of the peg transfer adds: what motion alone would take, the paper's rows, moments and paths."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kept_figures import kept_figures
from synthetic import synthetic_trial
from trocar.geometry import SE3
from trocar.log import Span
from trocar.tasks.peg_transfer import report as module
from trocar.tasks.peg_transfer.report import PAPER, PegReport, draw_paths, floor_sentence, motion_floor_s

# What motion alone would take.


def made(spans, duration_s, transfers, arms=("a", "b")):
    return SimpleNamespace(spans=spans, duration_s=duration_s, about={"arms": arms}, scores=[{}] * transfers)


def test_the_floor_is_that_of_the_arm_that_moves_most_and_the_rest_adds_up():
    spans = [
        Span("a", "motion", 0.0, 4.0),
        Span("a", "capture", 3.5, 4.5),
        Span("a", "waiting", 4.5, 6.0),
        Span("b", "motion", 1.0, 3.0),
    ]
    seconds = motion_floor_s([made(spans, 8.0, 2)])
    assert seconds == pytest.approx({"motion": 2.0, "capture": 0.25, "waiting": 0.75, "other": 1.0})
    assert sum(seconds.values()) == pytest.approx(8.0 / 2)


def test_the_sentence_names_the_largest_part_first():
    said = floor_sentence({"motion": 2.0, "jaw": 0.3, "waiting": 0.7, "other": 0.001})
    assert "2.00 s per transfer" in said and said.endswith("the 1.00 s above that are waiting 0.70, jaw 0.30")


def test_trials_without_transfers_have_no_floor():
    assert motion_floor_s([made([], 1.0, 0)])["motion"] == 0.0


# The paper.


@pytest.mark.parametrize(
    ("variant", "printed"),
    [
        ("unilateral", [(12.3, 95.9), (4.7, 100.0), (5.6, 34.7), (5.7, 100.0), (5.2, 100.0)]),
        ("bilateral", [(10.9, 97.5), (4.8, 97.5), (3.6, 54.4), (3.5, 100.0), (3.0, 100.0)]),
        ("handover", [(15.5, 94.8), (7.9, 100.0), (6.3, 17.7), (6.1, 100.0), (6.0, 100.0)]),
    ],
)
def test_counts_are_those_of_the_success_rates_that_the_paper_prints(variant, printed):
    """Mean time of a transfer in s, and success in %, of volunteers, surgeon and robot: Tables II to IV."""
    assert [(row.mean_time_s, round(100 * row.succeeded / row.attempted, 1)) for row in PAPER[variant]] == printed
    assert all(row.attempted == 120 for row in PAPER[variant][3:]), "ten trials of twelve transfers"


def test_each_row_of_the_paper_is_that_of_our_method_of_its_kind():
    ours = {method: row.who for row in PAPER["handover"] for method in row.methods}
    optimised = "robot, calibrated and optimised"
    assert ours == {
        "uncalibrated": "robot, uncalibrated",
        "calibrated": "robot, calibrated",
        "adaptive": "robot, calibrated",
        "optimized": optimised,
        "best": optimised,
    }


# Moments.

CLOSE, OPEN = (2.25, 2.5), (4.0, 4.25)


@pytest.mark.parametrize(
    ("motions", "jaws", "expected"),
    [
        ([(0.5, 2.0), (2.5, 3.5)], [CLOSE, OPEN], [2.25, 2.85, 3.15, 5.0]),
        ([(0.5, 2.0), (2.5, 3.5), (3.5, 3.9)], [CLOSE, OPEN], [2.25, 2.85, 3.5, 5.0]),
        ([(0.5, 0.8), (1.5, 2.0), (2.5, 3.5)], [(1.0, 1.2), (1.2, 1.4), CLOSE, OPEN], [2.25, 2.85, 3.15, 5.0]),
        ([(0.5, 2.0), (4.3, 5.0)], [CLOSE, OPEN], [2.25, 5.0]),
        ([(0.5, 2.0), (4.0, 5.0)], [CLOSE, OPEN], [2.25, 5.0]),
        ([(0.5, 2.0), (2.5, 3.5)], [CLOSE], [2.0]),
        ([], [], []),
    ],
    ids=["in one go", "stops over the target", "closed twice", "goes home", "opens as it goes", "never opened", "idle"],
)
def test_the_first_transfer_is_shown_step_by_step(motions, jaws, expected):
    """From when the jaws last close to when they open; of the motions between, the first one lifts the block."""
    spans = [Span("psm1", "motion", *span) for span in motions] + [Span("psm1", "jaw", *span) for span in jaws]
    spans += [Span("psm1", "motion", 5.5, 7.0), Span("psm1", "jaw", 7.0, 7.2), Span("psm1", "jaw", 8.0, 8.2)]
    moments = PegReport().moments(replace(synthetic_trial(), spans=spans))
    shown = [(words, at) for words, at in moments if not words.startswith(("start", "after"))]
    steps = ["jaws round the wall on peg 1", "lifted", "over the target", "released on peg 7"]
    assert [at for _, at in shown] == pytest.approx(expected)
    assert [words for words, _ in shown] == (steps if len(expected) == 4 else [steps[0], steps[3]][: len(expected)])


def test_a_first_transfer_that_failed_shows_where_the_arm_went_and_how_it_ended():
    words = [words for words, _ in PegReport().moments(synthetic_trial(failures={0: "DROPPED"}))]
    assert words[:2] == ["start", "jaws round the wall on peg 1"] and "peg 1 to 7: dropped" in words
    assert not any("lifted" in said or "released" in said for said in words)


def test_only_the_arm_at_work_is_shown_at_it():
    trial = synthetic_trial()
    event = {"name": "transfer", "time_s": 5.0, "arm": "psm2", "start_s": 0.0, "goal": 0, "outcome": "DONE"}
    spans = [replace(span, arm="psm2", start_s=span.start_s + 0.1, end_s=span.end_s + 0.1) for span in trial.spans]
    found = dict(PegReport().moments(replace(trial, events=[event], spans=sorted([*trial.spans, *spans], key=str))))
    assert found["jaws round the wall on peg 1"] == pytest.approx(2.35)


def test_every_quarter_of_a_trial_is_shown_and_no_more_than_three_failures():
    trial = synthetic_trial(failures=dict.fromkeys((1, 4, 7, 10), "NOT_PLACED"))
    moments = PegReport().moments(trial)
    assert [(words, at) for words, at in moments if words.startswith("after")] == [
        (f"after {number} transfers", 5.0 * number) for number in (3, 6, 9, 12)
    ]
    assert [at for words, at in moments if "not placed" in words] == [10.0, 25.0, 40.0]
    assert [at for _, at in moments] == sorted(at for _, at in moments)


def test_pictures_are_filled_by_the_board_wherever_it_stands():
    T_world_board = SE3.exp([0.02, -0.01, 0.0, 0.0, 0.0, 0.3])
    trial = synthetic_trial()
    moved = replace(trial, arrays=trial.arrays | {"T_world_board": T_world_board.matrix})
    corners = T_world_board.inverse().apply(PegReport().frame(moved))
    assert len({tuple(corner) for corner in corners.round(6).tolist()}) == 8
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], np.transpose(module.FRAME_M), atol=1e-9)


def test_a_dropped_block_is_shown_as_it_falls_and_another_failure_at_its_end():
    trial = synthetic_trial(failures={1: "DROPPED", 2: "NOT_PLACED"})
    block = np.zeros((len(trial.times_s), 7), np.float32)
    block[:, 2] = 0.05 * (trial.times_s < 8.3)
    still = np.zeros_like(block)
    still[trial.times_s < 20.0, 2] = 0.5  # it falls further, after that transfer
    fallen = replace(trial, arrays=trial.arrays | {"body_block0": block, "body_block1": still})
    assert PegReport().failed_s(fallen, fallen.scores[1]) == pytest.approx(8.3, abs=0.011)
    assert PegReport().failed_s(fallen, fallen.scores[2]) == 15.0


# Paths.


def test_a_path_is_drawn_from_above_and_from_the_side_each_transfer_in_its_own_colour(monkeypatch, tmp_path):
    figures = kept_figures(monkeypatch)
    times_s = np.linspace(2.0, 8.0, 61)
    p_m = np.column_stack([1e-3 * np.arange(61), np.full(61, 0.01), np.linspace(0.0, 0.03, 61)])
    transfer = np.repeat([-1, 0, 1, 2], [10, 20, 20, 11])
    draw_paths(times_s, p_m, transfer, tmp_path / "paths.png", "a path")
    above, side, bar = figures[0].axes
    for axes, columns in ((above, [0, 1]), (side, [0, 2])):
        (lines,) = axes.collections
        np.testing.assert_allclose([line[0] for line in lines.get_segments()], 1e3 * p_m[:-1, columns])
        numbers = lines.get_array()
        assert np.ma.getmaskarray(numbers).tolist() == [True] * 10 + [False] * 50, "grey before the first transfer"
        assert numbers.compressed().tolist() == (transfer[10:-1] + 1).tolist()
        assert len({tuple(rgba) for rgba in lines.to_rgba(numbers)}) == 4
    assert bar.get_yticks().tolist() == [1, 2, 3]
    length_m = np.linalg.norm(np.diff(p_m, axis=0), axis=1).sum()
    assert above.get_title("left") == f"a path: {length_m:.2f} m in 6.0 s"
    assert side.get_ylim()[0] <= -2.0 and side.get_ylim()[1] > 30.0


def test_the_path_of_each_arm_has_the_transfers_of_that_arm(monkeypatch, tmp_path):
    trial, drawn = synthetic_trial(), {}
    turns = [{"psm2": (0.0, 5.0)}, {"psm1": (2.0, 7.0), "psm2": (8.0, 9.0)}]
    events = [{"name": "transfer", "time_s": 9.0, "goal": goal, "turns": given} for goal, given in enumerate(turns)]

    def draw(times_s, p_m, transfer, path, title):
        drawn[path.name] = (times_s, transfer, title)
        return path

    monkeypatch.setattr(module, "draw_paths", draw)
    both = replace(trial, about=trial.about | {"arms": ["psm1", "psm2"]}, events=events)
    assert [path.name for path in PegReport().pictures(tmp_path, [both])] == ["paths_psm1.png", "paths_psm2.png"]
    for arm, times in (("psm1", {1: (2.0, 7.0)}), ("psm2", {0: (0.0, 5.0), 1: (8.0, 9.0)})):
        times_s, transfer, title = drawn[f"paths_{arm}.png"]
        expected = np.full(len(times_s), -1)
        for goal, (start_s, end_s) in times.items():
            expected[round(100 * start_s) : round(100 * end_s)] = goal
        assert transfer.tolist() == expected.tolist() and arm in title
    assert [path.name for path in PegReport().pictures(tmp_path, [trial])] == ["paths.png"]
