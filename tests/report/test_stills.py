"""Pictures of trials: storyboards, charts, paths."""

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from synthetic import synthetic_trial
from trocar.errors import TrocarError
from trocar.report.stills import draw_storyboard
from trocar.report.timechart import draw_timechart
from trocar.tasks.peg_transfer.report import draw_paths


def drawn(path):
    assert path.stat().st_size < 500_000
    image = matplotlib.image.imread(path)[..., :3]
    assert image.std() > 0.01
    return image


def tool_path():
    times = np.linspace(0, 6, 120)
    tips = np.stack([0.04 * np.sin(times), 0.01 * np.cos(times), 0.03 + 0.02 * np.sin(2 * times)], axis=1)
    return times, tips, np.where(times < 1, -1, (times > 3).astype(int))


def test_pictures_are_written_small_and_a_storyboard_thins_out_what_it_is_given(tmp_path):
    drawn(draw_timechart(synthetic_trial(), tmp_path / "new" / "time.png"))
    drawn(draw_paths(*tool_path(), tmp_path / "paths.png", "a path"))
    shades = np.tile(np.linspace(0, 255, 640).astype(np.uint8)[None, :, None], (480, 1, 3))
    frames = [(f"step {k}", shades) for k in range(30)]
    one, all_ = (drawn(draw_storyboard(some, tmp_path / "story.png", "a story")) for some in (frames[:1], frames))
    assert one.shape[1] == all_.shape[1] > 1000
    row_in = 9.6 / 4 * 480 / 640 + 0.28
    assert all_.shape[0] == pytest.approx(130 * (3 * row_in + 0.4), abs=3), "three rows of four pictures"


def test_nothing_to_draw_is_one_sentence_and_no_file(tmp_path):
    with pytest.raises(TrocarError, match="at least one span"):
        draw_timechart(replace(synthetic_trial(), spans=[]), tmp_path / "a.png")
    with pytest.raises(TrocarError, match="at least one picture"):
        draw_storyboard([], tmp_path / "a.png", "a story")
    assert not list(tmp_path.iterdir())
