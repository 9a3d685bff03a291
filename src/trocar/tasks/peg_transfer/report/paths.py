"""Where the tool went: its path over the board, from above and from the side."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.patches import Circle, Rectangle
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.report import style

PEG_RADIUS_MM, PEG_HEIGHT_MM = 1.75, 20.0  # facts/peg_transfer.md, "The board and the blocks"
BOARD_MM = (152.0, 105.0)  # width and depth of the board's lowest plate, as drawn


def draw_paths(
    times_s: ArrayLike,
    p_board_m: ArrayLike,
    transfer: ArrayLike,
    pegs_m: ArrayLike,
    path: Path,
    *,
    title: str = "Path of the tool over the board",
) -> Path:
    """Draw the path of the tip from above and from the side, coloured by transfer, and return the path.

    Args:
        times_s: (n,) increasing.
        p_board_m: (n, 3) tip in the board frame, z up along the pegs.
        transfer: (n,) index of the transfer, below 0 where there is none.
        pegs_m: (pegs, 2) or (pegs, 3), feet of the pegs in the board frame.
        path: of the picture.
        title: above it.
    """
    times, tip = np.asarray(times_s, dtype=np.float64), 1e3 * np.asarray(p_board_m, dtype=np.float64)
    index, pegs = np.asarray(transfer, dtype=np.float64), 1e3 * np.asarray(pegs_m, dtype=np.float64)
    if tip.shape != (len(times), 3) or index.shape != times.shape or len(times) < 2:
        raise TrocarError(
            f"a tool path needs times (n,), tips (n, 3), transfers (n,), n of 2 or more; got {times.shape}, "
            f"{tip.shape}, {index.shape}"
        )
    with style.figure(8.2, 8.0, path) as figure:
        above, side = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
        _board_from_above(above, pegs)
        _board_from_side(side, pegs)
        count = max(1, int(index.max()) + 1)
        norm = BoundaryNorm(np.arange(count + 1) + 0.5, 256) if count > 1 else None
        for axes, columns in ((above, (0, 1)), (side, (0, 2))):
            lines = _coloured(tip[:, columns], index, norm)
            axes.add_collection(lines)
        if norm is not None:
            bar = figure.colorbar(lines, ax=[above, side], pad=0.01, aspect=40, ticks=np.arange(1, count + 1))
            bar.set_label("transfer")
        above.set_aspect("equal", adjustable="datalim")
        above.set_ylabel("y in the board frame, mm")
        side.set_xlabel("x in the board frame, mm")
        side.set_ylabel("height over the plate, mm")
        side.set_ylim(min(-2.0, tip[:, 2].min() - 2), max(tip[:, 2].max(), PEG_HEIGHT_MM) + 5)
        length_m = np.linalg.norm(np.diff(tip, axis=0), axis=1).sum() / 1e3
        above.set_title(f"{title}: {length_m:.2f} m in {times[-1] - times[0]:.1f} s")
        side.set_title("From the side")
    return path


def _coloured(flat: NDArray[np.float64], index: NDArray[np.float64], norm: Normalize | None) -> LineCollection:
    """Return the path as segments coloured by transfer; grey where there is none."""
    segments = np.stack([flat[:-1], flat[1:]], axis=1)
    if norm is None:
        return LineCollection(list(segments), colors=style.BLUE, linewidths=1.2)
    values = np.where(index[:-1] < 0, np.nan, index[:-1] + 1)
    cmap = mpl.colormaps[style.PATHS].with_extremes(bad="#BBBBBB")
    lines = LineCollection(list(segments), cmap=cmap, norm=norm, linewidths=1.2)
    lines.set_array(np.ma.masked_invalid(values))
    return lines


def _board_from_above(axes: Axes, pegs: NDArray[np.float64]) -> None:
    """Draw the outline of the board and its numbered pegs."""
    width, depth = BOARD_MM
    axes.add_patch(
        Rectangle((-width / 2, -depth / 2), width, depth, facecolor="#F7F5EF", edgecolor=style.QUIET, zorder=0)
    )
    for number, peg in enumerate(pegs):
        axes.add_patch(Circle(tuple(peg[:2]), PEG_RADIUS_MM, facecolor=style.INK, edgecolor="white", zorder=3))
        axes.annotate(
            str(number),
            tuple(peg[:2]),
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=8,
            color=style.INK,
            zorder=4,
        )
    axes.update_datalim([(-width / 2, -depth / 2), (width / 2, depth / 2)])
    axes.autoscale_view()


def _board_from_side(axes: Axes, pegs: NDArray[np.float64]) -> None:
    """Draw the plate and the pegs' silhouettes."""
    axes.axhline(0, color=style.QUIET, linewidth=1)
    for peg in pegs:
        axes.add_patch(
            Rectangle((peg[0] - PEG_RADIUS_MM, 0), 2 * PEG_RADIUS_MM, PEG_HEIGHT_MM, facecolor="#C9C9C9", zorder=1)
        )
