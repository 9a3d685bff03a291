"""Videos of trials."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from synthetic import synthetic_trial
from trocar.report.files import report_of
from trocar.report.video import draw_video


def frames_of(path):
    if path.suffix == ".webp":
        with Image.open(path) as film:
            return getattr(film, "n_frames", 1)
    av = pytest.importorskip("av")
    with av.open(str(path)) as file:
        return sum(1 for _ in file.decode(video=0))


@pytest.mark.parametrize("name", ["video.webp", "video.mp4"])
@pytest.mark.parametrize(("duration_s", "webp", "mp4"), [(0.0, 1, 1), (1.0, 3, 25)])
def test_a_trial_that_ends_at_once_has_one_frame(monkeypatch, tmp_path, name, duration_s, webp, mp4):
    """An agent that cannot start ends its trial at 0 s."""
    if name.endswith("mp4"):
        pytest.importorskip("av")
    shown_s, ticks = [], []

    def picture(time_s):
        shown_s.append(time_s)
        return np.full((48, 64, 3), 20 + int(200 * time_s), np.uint8)

    monkeypatch.setattr("trocar.report.video.photographer_of", lambda *_: SimpleNamespace(picture=picture))
    trial = replace(synthetic_trial(), duration_s=duration_s)
    path = draw_video(trial, tmp_path / name, report_of(trial), lambda *tick: ticks.append(tick))
    wanted = webp if name.endswith("webp") else mp4
    assert frames_of(path) == len(shown_s) == wanted and ticks[-1] == (wanted, wanted)
    assert shown_s[0] == 0.0 and shown_s[-1] <= duration_s
