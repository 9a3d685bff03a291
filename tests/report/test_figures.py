import io

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from trocar.errors import TrocarError
from trocar.report import draw_paths, draw_storyboard, draw_timechart, parts_table, run_table

SPANS = [
    {"arm": "psm1", "name": "capture", "start_s": 0.0, "end_s": 0.5, "transfer": 0},
    {"arm": "psm1", "name": "move", "start_s": 0.5, "end_s": 2.0, "transfer": 0},
    {"arm": "psm1", "name": "a part of its own", "start_s": 2.0, "end_s": 2.5, "transfer": 1},
    {"arm": "psm1", "name": "home", "start_s": 2.5, "end_s": 3.0, "transfer": None},
]
PEGS_M = np.array([[-0.0405, 0.0], [0.0407, 0.0109]])
SUMMARY = {
    "task": "peg-transfer",
    "variant": "unilateral",
    "method": "calibrated",
    "trials": 1,
    "attempted": 12,
    "succeeded": 11,
    "success_rate": 11 / 12,
    "success_ci95": [0.646, 0.985],
    "mean_time_s": None,
    "parts_s": {"motion": 3.0, "jaw": 1.0},
}


def drawn(path):
    assert path.stat().st_size < 500_000
    image = matplotlib.image.imread(path)[..., :3]
    assert image.std() > 0.01
    return image


def tool_path():
    times = np.linspace(0, 6, 120)
    tips = np.stack([0.04 * np.sin(times), 0.01 * np.cos(times), 0.03 + 0.02 * np.sin(2 * times)], axis=1)
    return times, tips, np.where(times < 1, -1, (times > 3).astype(int))


def test_figures_are_written_small_and_not_empty(tmp_path):
    drawn(draw_timechart(SPANS, tmp_path / "new" / "time.png"))
    drawn(draw_paths(*tool_path(), PEGS_M, tmp_path / "paths.png"))
    rng = np.random.default_rng(0)
    frames = [(f"step {k}", rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)) for k in range(30)]
    image = matplotlib.image.imread(draw_storyboard(frames[:1], tmp_path / "one.png"))
    assert image.shape[1] > 1000
    assert draw_storyboard([(c, f // 9 * 9 + 4) for c, f in frames], tmp_path / "story.png").exists()


def test_two_arms_have_rows_of_their_own(tmp_path):
    one = drawn(draw_timechart(SPANS, tmp_path / "one.png"))
    both = drawn(draw_timechart([*SPANS, {**SPANS[0], "arm": "psm2"}], tmp_path / "both.png"))
    assert both.shape[0] > one.shape[0]


def test_what_an_arm_does_after_the_last_transfer_has_a_row_of_its_own(tmp_path):
    late = {**SPANS[3], "start_s": 60.0, "end_s": 61.0, "transfer": -1}
    early = {**SPANS[3], "start_s": -1.0, "end_s": 0.0, "transfer": -1}
    both = drawn(draw_timechart([early, *SPANS[:3], late], tmp_path / "both.png"))
    one = drawn(draw_timechart([early, *SPANS[:3]], tmp_path / "one.png"))
    assert both.shape[0] > one.shape[0]


def test_nothing_to_draw_is_one_sentence_and_no_file(tmp_path):
    times, tips, index = tool_path()
    with pytest.raises(TrocarError, match="at least one span"):
        draw_timechart([], tmp_path / "a.png")
    with pytest.raises(TrocarError, match="tool path needs"):
        draw_paths(times[:-1], tips, index, PEGS_M, tmp_path / "a.png")
    with pytest.raises(TrocarError, match="at least one picture"):
        draw_storyboard([], tmp_path / "a.png")
    with pytest.raises(TrocarError, match="picture 'grey'"):
        draw_storyboard([("grey", np.zeros((4, 4), np.uint8))], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_tables_show_the_run_beside_the_paper():
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(run_table(SUMMARY))
    console.print(parts_table(SUMMARY))
    text = console.export_text()
    for words in ("11 of 12", "91.7 %", "64.6 % to 98.5 %", "34.7 %", "12.30", "75.0 %"):
        assert words in text


def test_a_part_of_less_than_nothing_by_rounding_is_nothing():
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(parts_table({**SUMMARY, "parts_s": {"motion": 3.0, "other": -2e-15}}))
    assert "-0.0" not in console.export_text()
