"""A trial at a glance: a grid of pictures with captions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.report import style

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
