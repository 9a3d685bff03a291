"""Videos of trials."""

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from synthetic import synthetic_trial
from trocar.errors import InvalidInput, UnknownName
from trocar.replay import CameraImage
from trocar.report.files import report_of
from trocar.report.video import FPS, draw_video, film_camera, images_of


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


def image(time_s, grey, camera="overhead", size=(65, 48)):
    """Return an image of one shade of grey."""
    file = io.BytesIO()
    Image.new("RGB", size, (grey, grey, grey)).save(file, "PNG")
    return CameraImage(time_s, camera, file.getvalue())


def test_a_camera_s_film_shows_each_image_until_the_next_one(tmp_path):
    av = pytest.importorskip("av")
    ticks = []
    images = [image(0.4, 90), image(1.0, 160), image(1.02, 30), image(1.2, 230)]
    path = film_camera(images, 2.0, tmp_path / "video_overhead.mp4", lambda *tick: ticks.append(tick))
    with av.open(str(path)) as file:
        shades = [frame.to_ndarray(format="rgb24").mean() for frame in file.decode(video=0)]
        stream = file.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (64, 48, FPS)
    wanted = [0.0] * 10 + [90.0] * 15 + [160.0] + [30.0] * 4 + [230.0] * 20
    np.testing.assert_allclose(shades, wanted, atol=4.0)
    assert ticks[-1] == (50, 50)


def test_images_are_those_of_the_camera_in_order_and_a_wrong_name_is_told_the_choices(monkeypatch):
    trial = synthetic_trial()
    shots = (image(2.0, 9, "left"), image(1.0, 9, "right"), image(0.5, 9, "left"))
    monkeypatch.setattr(type(trial), "replay", lambda self: SimpleNamespace(images=shots))
    assert images_of(trial, "left") == [shots[2], shots[0]]
    with pytest.raises(UnknownName, match="camera 'rigth' is unknown; did you mean 'right'"):
        images_of(trial, "rigth")
    monkeypatch.undo()
    with pytest.raises(UnknownName, match="camera 'left' is unknown; the trial has no camera images"):
        images_of(trial, "left")


def test_a_damaged_image_is_one_sentence_and_no_film(tmp_path):
    pytest.importorskip("av")
    images = [image(0.0, 9), CameraImage(1.0, "overhead", b"not an image")]
    with pytest.raises(InvalidInput, match=r"image of camera 'overhead' at 1.00 s is damaged"):
        film_camera(images, 2.0, tmp_path / "video.mp4", lambda *tick: None)
    assert not list(tmp_path.iterdir())
