"""Images of trials: the storyboard, a still of each goal that was not reached."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.eval import TaskReport
from trocar.eval.trial import Trial
from trocar.extras import how_to_install
from trocar.report import style
from trocar.report.failures import Failed
from trocar.report.page import Captioned

if TYPE_CHECKING:
    from trocar.sim.offscreen import OffscreenCamera

MAX_PICTURES = 12  # of a storyboard; more are thinned out evenly, keeping the first and last
LARGEST_PX = 400  # a picture of a storyboard is reduced to at most this width
SCALE, QUALITY = 0.75, 60  # of pictures of failed goals: of 640 pixels; and WebP's
MOST_FAILED = 12  # failed goals with a picture; the page says how many more there are


def can_photograph() -> bool:
    """Return whether the simulator, which draws the pictures, is installed."""
    return find_spec("mujoco") is not None


def photographer_of(trial: Trial, report: TaskReport, scale: float = 1.0) -> OffscreenCamera:
    """Return the camera that draws a trial, 640 pixels wide times ``scale``, from the viewpoint that its task defines.

    Raises:
        TrocarError: the simulator is not installed.
    """
    if not can_photograph():
        raise InvalidInput("pictures", "of a trial need mujoco", how_to_install("sim"))
    from trocar.sim.offscreen import OffscreenCamera  # an extra

    return OffscreenCamera(trial.replay(), report.view, report.colours, scale, report.frame(trial))


def draw_storyboard(
    frames: Sequence[tuple[str, NDArray[np.uint8]]], path: str | Path, title: str, columns: int = 4
) -> Path:
    """Draw captioned pictures ((height, width, 3) uint8 RGB) in a grid, in order, and return the path."""
    path = Path(path)
    if not frames:
        raise InvalidInput("a storyboard", "needs at least one picture", "the trial kept none")
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


def draw_failed(
    folder: str | Path, trials: Sequence[Trial], failed: Sequence[Failed], report: TaskReport, draw: bool = True
) -> list[Captioned]:
    """Draw a picture of each failed goal at the moment that shows its failure, and return them.

    Each trial is read once. With ``draw`` off (no simulator is installed), return the pictures that exist already.
    """
    found = []
    for place, of_trial in groupby(failed, key=lambda one: one.place):
        trial = trials[place]
        photographer = photographer_of(trial, report, SCALE) if draw else None
        for one in of_trial:
            time_s, path = report.failed_s(trial, trial.scores[one.number]), Path(folder) / f"{one.stem}.png"
            if photographer is not None:
                style.write_png(path, photographer.picture(time_s))
            elif not path.is_file():
                continue
            why = f". {one.reason[:1].upper()}{one.reason[1:]}" if one.reason else ""
            found.append(Captioned(path, f"The cell at {time_s:.1f} s: {one}", f"{one}, at {time_s:.1f} s{why}"))
    return found
