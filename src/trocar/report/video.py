"""A short moving picture of a trial, for a README or slides."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from trocar.output import PICTURE, mark_of, writing
from trocar.report.photographs import photographer_of
from trocar.tasks.kit import TaskReport
from trocar.trials.trial import Trial

FRAMES_PER_S = 12
SPEED = 4.0
"""So many seconds of the trial in one of the picture."""
MAX_S = 15.0
"""A longer picture is cut: it is for looking at, not for study."""
SCALE = 0.75
"""Of 640 pixels from left to right."""
QUALITY = 60


def draw_video(
    trial: Trial,
    path: str | Path,
    report: TaskReport | None = None,
    tick: Callable[[int, int], None] = lambda k, n: None,
) -> Path:
    """Write an animated WebP of a trial, four times as fast as it was, and return its path.

    Args:
        trial: which.
        path: of the picture, ending in ``.webp``.
        report: of its task: from where it is looked at, and colours.
        tick: called with the number of each frame and how many there are.

    Raises:
        TrocarError: there is no simulator here, whose rays draw the pictures.
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
