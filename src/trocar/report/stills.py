"""Images of a trial: stills, the storyboard, a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import InvalidInput
from trocar.eval import TaskReport
from trocar.eval.trial import Trial
from trocar.extras import how_to_install
from trocar.files.output import PICTURE, mark_of, writing
from trocar.report import style

if TYPE_CHECKING:
    from trocar.sim.offscreen import OffscreenCamera


def can_photograph() -> bool:
    """Return whether the simulator, which draws the pictures, is installed."""
    return find_spec("mujoco") is not None


def photographer_of(trial: Trial, report: TaskReport, scale: float = 1.0) -> OffscreenCamera:
    """Return an object that draws pictures of a trial, from the viewpoint and with the frame that its task defines.

    Args:
        trial: the trial.
        report: of its task.
        scale: of the pictures' width of 640 pixels.

    Raises:
        TrocarError: the simulator is not installed.
    """
    if not can_photograph():
        raise InvalidInput("pictures", "of a trial need mujoco", f"{how_to_install('sim')}")
    from trocar.sim.offscreen import OffscreenCamera  # an extra

    return OffscreenCamera(trial.replay(), report.view, report.colours, scale, report.frame(trial))


MAX_PICTURES = 12  # more are thinned out evenly, keeping the first and last
LARGEST_PX = 400  # a picture is reduced to at most this width


def draw_storyboard(
    frames: Sequence[tuple[str, NDArray[np.uint8]]], path: str | Path, title: str = "Storyboard", columns: int = 4
) -> Path:
    """Draw the captioned pictures in a grid, in order, and return the path.

    Args:
        frames: caption and (height, width, 3) uint8 RGB each.
        path: of the picture.
        title: above the grid.
        columns: pictures in a row.
    """
    path = Path(path)
    if not frames:
        raise InvalidInput("a storyboard", "needs at least one picture", "the trial kept none")
    for caption, image in frames:
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InvalidInput(
                f"picture '{caption}'", f"is {image.dtype} of shape {image.shape}", "it must be uint8 (h, w, 3)"
            )
    kept = [frames[i] for i in np.linspace(0, len(frames) - 1, min(MAX_PICTURES, len(frames))).round().astype(int)]
    columns = min(columns, len(kept))
    rows = -(-len(kept) // columns)
    height, width = kept[0][1].shape[:2]
    cell_in = 9.6 / columns
    with style.figure(9.6, rows * (cell_in * height / width + 0.28) + 0.4, path) as figure:
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid:
            axes.set_axis_off()
        for number, (axes, (caption, image)) in enumerate(zip(grid, kept, strict=False), start=1):
            thin = max(1, image.shape[1] // LARGEST_PX)
            axes.imshow(image[::thin, ::thin], interpolation="antialiased")
            axes.set_title(f"{number}  {caption}", fontsize=8, fontweight="normal", color=style.INK)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return path


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
