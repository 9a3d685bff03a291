"""Videos of trials: a short animation for a page, the whole trial for a talk, and what one of its cameras saw."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from trocar.errors import InvalidInput, UnknownName
from trocar.eval import TaskReport
from trocar.eval.trial import Trial
from trocar.files.output import PICTURE, mark_of, writing
from trocar.files.video import mp4, require_encoder
from trocar.replay import CameraImage
from trocar.report.stills import photographer_of

Tick = Callable[[int, int], None]

ANIMATED_FPS, SPEED = 12, 4.0  # of an animation; seconds of the trial per second of it
MAX_S = 15.0  # a longer animation is cut: it is an illustration, not a record
SCALE, QUALITY = 0.75, 60  # of its frames: of 640 pixels; and WebP's

FPS = 25  # of an MP4, at the trial's own speed
OPTIONS = {"preset": "medium", "crf": "20"}


def draw_video(trial: Trial, path: str | Path, report: TaskReport, tick: Tick) -> Path:
    """Write a trial as an animated WebP at four times its speed, or as a whole MP4 at its own, and return the path.

    Args:
        trial: the trial.
        path: of the file, ``.webp`` or ``.mp4``.
        report: of its task, which defines the viewpoint.
        tick: called with the number of each frame and how many there are.

    Raises:
        TrocarError: the simulator, which draws the pictures, or the encoder is not installed.
    """
    path = Path(path)
    (_film if path.suffix == ".mp4" else _animation)(trial, path, report, tick)
    return path


def images_of(trial: Trial, camera: str) -> list[CameraImage]:
    """Return the images that a camera took in a trial, in order.

    Raises:
        UnknownName: the trial has no image of it.
    """
    images = trial.replay().images
    taken = sorted((image for image in images if image.camera == camera), key=lambda image: image.time_s)
    if not taken:
        cameras = dict.fromkeys(image.camera for image in images)
        raise UnknownName("camera", camera, cameras, remedy="" if cameras else "the trial has no camera images")
    return taken


def film_camera(images: Sequence[CameraImage], duration_s: float, path: str | Path, tick: Tick) -> Path:
    """Write the images of a camera as an MP4 at the trial's own speed, and return the path.

    Each image is shown until the next one was taken; before the first, the film is black.

    Args:
        images: of one camera, at least one, in order.
        duration_s: of the trial.
        path: of the file.
        tick: called with the number of each frame and how many there are.

    Raises:
        TrocarError: the encoder is not installed, or an image is damaged.
    """
    require_encoder()
    times_s = _frames_until(duration_s, 1.0 / FPS)
    places = np.searchsorted([image.time_s for image in images], times_s + 1e-9, side="right") - 1
    black, shown = np.zeros_like(_decoded(images[0])), None
    with writing(path, PICTURE) as draft, mp4(draft, black.shape[:2], FPS, OPTIONS, mark_of(PICTURE)) as add:
        for number, place in enumerate(places.tolist(), start=1):
            add(None if place == shown else black if place < 0 else _decoded(images[place]))
            shown = place
            tick(number, len(places))
    return Path(path)


def _decoded(image: CameraImage) -> NDArray[np.uint8]:
    try:
        with Image.open(io.BytesIO(image.encoded)) as file:
            return _even(np.asarray(file.convert("RGB")))
    except (UnidentifiedImageError, OSError, ValueError):
        what = f"the image of camera {image.camera!r} at {image.time_s:.2f} s"
        raise InvalidInput(what, "is damaged", "run the trial again") from None


def _animation(trial: Trial, path: Path, report: TaskReport, tick: Tick) -> None:
    times_s = _frames_until(min(trial.duration_s, MAX_S * SPEED), SPEED / ANIMATED_FPS)
    frames = [Image.fromarray(picture) for picture in _pictures(trial, report, SCALE, times_s, tick)]
    how: dict[str, Any] = {"duration": round(1e3 / ANIMATED_FPS), "loop": 0, "quality": QUALITY, "method": 4}
    with writing(path, PICTURE) as draft:
        frames[0].save(draft, xmp=mark_of(PICTURE).encode(), save_all=True, append_images=frames[1:], **how)


def _film(trial: Trial, path: Path, report: TaskReport, tick: Tick) -> None:
    require_encoder()
    pictures = _pictures(trial, report, 1.0, _frames_until(trial.duration_s, 1.0 / FPS), tick)
    first = _even(next(pictures))
    with writing(path, PICTURE) as draft, mp4(draft, first.shape[:2], FPS, OPTIONS, mark_of(PICTURE)) as add:
        add(first)
        for picture in pictures:
            add(_even(picture))


def _frames_until(end_s: float, every_s: float) -> NDArray[np.float64]:
    """Return the times (k,) of frames, at least one: an agent that cannot start ends its trial at 0 s."""
    return np.arange(0.0, max(end_s, every_s), every_s)


def _pictures(
    trial: Trial, report: TaskReport, scale: float, times_s: NDArray[np.float64], tick: Tick
) -> Iterator[NDArray[np.uint8]]:
    """Yield pictures (h, w, 3) of a trial at these times, 640 pixels wide times ``scale``."""
    photographer = photographer_of(trial, report, scale)
    for number, time_s in enumerate(times_s.tolist(), start=1):
        yield photographer.picture(time_s)
        tick(number, len(times_s))


def _even(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture without the last row or column, if their number is odd: H.264 wants both even."""
    height, width = (side - side % 2 for side in picture.shape[:2])
    return picture[:height, :width]
