"""One style for every figure: colours that colour-blind readers can distinguish, units on axes, small files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from trocar.files.output import PICTURE, make_folder, mark_of, write_figure, writing

# Okabe and Ito 2008: distinguishable with every common colour blindness
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, YELLOW = "#56B4E9", "#CC79A7", "#F0E442"
SERIES = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY)  # of methods, arms or paths side by side, in this order
INK, QUIET, FAINT = "#222222", "#6B6B6B", "#E4E4E4"
PATHS = "viridis"  # uniform in lightness, so it also prints in grey
DPI = 130
LARGEST_BYTES = 500_000

RC: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # no search for ticks above the axes, which would take a tenth of a picture's time
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.7,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "legend.frameon": False,
    "figure.facecolor": "white",
}


class Picture(Figure):
    """A figure that a notebook displays, whether or not it has been configured for figures."""

    def _repr_png_(self) -> bytes:
        image = BytesIO()
        with mpl.rc_context(RC):
            self.savefig(image, format="png", dpi=DPI)
        return image.getvalue()


def picture(draw: Callable[[Figure], None], *, placed: bool = False) -> Picture:
    """Return the figure that ``draw`` draws, in this style; nothing is written.

    Args:
        draw: draws into an empty figure.
        placed: whether it places all axes itself.
    """
    with mpl.rc_context(RC):
        drawn = Picture(layout=None if placed else "constrained")
        draw(drawn)
        drawn.draw_without_rendering()  # ticks get their colours at the first layout
    return drawn


@contextmanager
def figure(width_in: float, height_in: float, path: str | Path, *, placed: bool = False) -> Iterator[Figure]:
    """Yield a figure of this size and save it to ``path`` when the block ends without an error.

    Args:
        width_in: its width.
        height_in: its height.
        path: of the picture.
        placed: whether the block places all axes itself. Otherwise they are laid out by the room that their texts need,
            which takes as long as drawing. A placed figure is also compressed faster, into a file a tenth larger.
    """
    path = Path(path)
    layout, options = (None, {"pil_kwargs": {"compress_level": 2}}) if placed else ("constrained", {})
    with mpl.rc_context(RC):
        drawn = Figure(figsize=(width_in, height_in), layout=layout)
        yield drawn
        make_folder(path.parent)
        write_figure(path, drawn, dpi=DPI, **options)
    if path.stat().st_size > LARGEST_BYTES:
        with Image.open(path) as full:
            write_png(path, full.copy())


def write_png(path: str | Path, image: Image.Image | NDArray[np.uint8]) -> Path:
    """Write a camera's picture as a PNG of 256 colours, a third of the size of a full one, and return its path."""
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    path, mark = Path(path), PngInfo()
    mark.add_text("Software", mark_of(PICTURE))
    make_folder(path.parent)
    with writing(path, PICTURE) as draft:
        image.convert("RGB").quantize(256).save(draft, optimize=True, pnginfo=mark)
    return path
