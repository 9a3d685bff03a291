"""A short animation of a trial, for a README or slides."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from trocar.eval import TaskReport
from trocar.eval.trial import Trial
from trocar.files.output import PICTURE, mark_of, writing
from trocar.report.stills import photographer_of

FRAMES_PER_S = 12
SPEED = 4.0
"""Seconds of the trial per second of the animation."""
MAX_S = 15.0
"""A longer animation is cut: it is an illustration, not a record."""
SCALE = 0.75
"""Scale of the animation, relative to a width of 640 pixels."""
QUALITY = 60


def draw_video(
    trial: Trial,
    path: str | Path,
    report: TaskReport | None = None,
    tick: Callable[[int, int], None] = lambda k, n: None,
) -> Path:
    """Write an animated WebP of a trial at four times its speed, and return its path.

    Args:
        trial: the trial.
        path: of the file, ending in ``.webp``.
        report: of its task: viewpoint and colours.
        tick: called with the number of each frame and how many there are.

    Raises:
        TrocarError: the simulator, which draws the pictures, is not installed.
    """
    path = Path(path)
    photographer = photographer_of(trial, report or TaskReport(), SCALE)
    times = np.arange(0.0, min(trial.duration_s, MAX_S * SPEED), SPEED / FRAMES_PER_S)
    frames = []
    for number, time_s in enumerate(times.tolist()):
        frames.append(Image.fromarray(photographer.picture(time_s)))
        tick(number + 1, len(times))
    with writing(path, PICTURE) as draft:
        frames[0].save(
            draft,
            xmp=mark_of(PICTURE).encode(),
            save_all=True,
            append_images=frames[1:],
            duration=round(1e3 / FRAMES_PER_S),
            loop=0,
            quality=QUALITY,
            method=4,
        )
    return path
