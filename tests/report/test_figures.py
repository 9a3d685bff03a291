import io
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from synthetic import synthetic_trial
from trocar.errors import TrocarError
from trocar.report.files import draw_trial
from trocar.report.stills import draw_storyboard
from trocar.report.tables import parts_table, run_table
from trocar.report.timechart import draw_timechart
from trocar.tasks.peg_transfer.report.peg_report import PAPER, PegReport, draw_paths

PEGS_M = np.array([[-0.0405, 0.0], [0.0407, 0.0109]])
SUMMARY = {
    "task": "peg-transfer",
    "variant": "unilateral",
    "method": "calibrated",
    "model": "play",
    "goal_noun": "transfer",
    "trials": 2,
    "sessions": 1,
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


@pytest.mark.slow
def test_figures_are_written_small_and_not_empty(tmp_path):
    drawn(draw_timechart(synthetic_trial(), tmp_path / "new" / "time.png"))
    drawn(draw_paths(*tool_path(), PEGS_M, tmp_path / "paths.png"))
    rng = np.random.default_rng(0)
    frames = [(f"step {k}", rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)) for k in range(30)]
    image = matplotlib.image.imread(draw_storyboard(frames[:1], tmp_path / "one.png"))
    assert image.shape[1] > 1000
    assert draw_storyboard([(c, f // 9 * 9 + 4) for c, f in frames], tmp_path / "story.png").exists()


def test_the_storyboard_of_a_trial_shows_its_moments(tmp_path):
    trial = synthetic_trial(failures={3: "DROPPED"})
    image = drawn(draw_trial(trial, tmp_path / "story.png"))
    assert image.shape[1] > 1000
    captions = [caption for caption, _ in PegReport().moments(trial)]
    assert captions[0] == "start" and "peg 2 to 9: dropped" in captions and "after 12 transfers" in captions
    assert "lifted" in captions and "released on peg 7" in captions


def test_the_path_of_the_tool_is_drawn_over_the_board_where_it_was(tmp_path):
    (path,) = PegReport().pictures(tmp_path, [synthetic_trial()])
    assert path.name == "paths.png"
    drawn(path)


def test_nothing_to_draw_is_one_sentence_and_no_file(tmp_path):
    times, tips, index = tool_path()
    with pytest.raises(TrocarError, match="at least one span"):
        draw_timechart(replace(synthetic_trial(), spans=[]), tmp_path / "a.png")
    with pytest.raises(TrocarError, match="tool path needs"):
        draw_paths(times[:-1], tips, index, PEGS_M, tmp_path / "a.png")
    with pytest.raises(TrocarError, match="at least one picture"):
        draw_storyboard([], tmp_path / "a.png")
    with pytest.raises(TrocarError, match="picture 'grey'"):
        draw_storyboard([("grey", np.zeros((4, 4), np.uint8))], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def printed(*tables):
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(*tables)
    return console.export_text()


def test_tables_show_the_run_beside_the_paper():
    text = printed(run_table(SUMMARY, PAPER["unilateral"]), parts_table(SUMMARY))
    for words in ("11 of 12", "91.7 %", "64.6 % to 98.5 %", "34.7 %", "12.30", "75.0 %"):
        assert words in text
    assert "2 trials in 1 session, simulated" in " ".join(text.split()) and "trocar, calibrated (play)" in text
    assert text.index("paper: robot, calibrated") < text.index("paper: surgeon") and "120 of 120" in text
    text = printed(run_table(SUMMARY | {"method": "uncalibrated"}, PAPER["unilateral"][::-1]))
    assert text.rindex("paper: surgeon") > text.rindex("paper: robot, uncalibrated")


def test_a_run_without_a_paper_and_without_a_model_has_a_table_too():
    text = printed(run_table({**SUMMARY, "model": None, "success_rate": None, "attempted": 0, "succeeded": 0}))
    assert "paper" not in text and "trocar, calibrated " in text and "0 of 0" in text
    parts = printed(parts_table({**SUMMARY, "parts_s": {"motion": 3.0, "other": -2e-15}}))
    assert "-0.0" not in parts, "less than nothing by rounding is nothing"
