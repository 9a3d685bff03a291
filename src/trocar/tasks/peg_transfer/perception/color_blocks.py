"""Blocks on the board from a colour image without depth, by the shadows in their holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from trocar.errors import TrocarError
from trocar.perception.color import red_mask

SHADES = (0.30, 0.35, 0.40, 0.45)
"""Thresholds for shadow, as shares of the plate's brightness; a hole may stand out at only one of them."""

BRIGHT_PERCENTILE = 60.0
BOARD_WIDTH_M = 0.152
HOLE_WIDTH_M = (1.6e-3, 3.9e-3)
"""Width of the crescent between peg and wall (peg 3.5 mm, hole 7.6-9.8 mm in diameter); a peg's shadow is wider."""

HOLE_HEIGHT_M = (2.9e-3, 8.6e-3)
HOLE_AREA_M2 = (2.9e-6, 2.0e-5)
MIN_ASPECT = 1.35
"""Minimum height over width in the image, as the wall hides one side; screws in the board are wider than high."""

RIM_M = (0.6e-3, 1.9e-3)
MIN_RIM = 0.70
"""Minimum median brightness of the rim, as a share of the plate's: a lit top and a lit peg surround a hole."""

SAME_BLOCK_M = 7e-3
MIN_BOARD_PIXELS = 2000


def find_blocks_in_color(color: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the pixels (n, 2) u, v of the holes of the blocks on pegs, from top to bottom of the image.

    Red blocks on a red board differ only in shade. Only a block has a hole whose shadow is separated by a lit rim from
    all other shadows. The board, the largest red region, gives scale and brightness. Light must come from one side, as
    from a structured-light projector; a hole that is fully lit is not found.

    Args:
        color: (h, w, 3) RGB, the whole board in view.

    Raises:
        TrocarError: the image is not (h, w, 3) of uint8, or shows no board.
    """
    color = np.asarray(color)
    if color.ndim != 3 or color.shape[-1] != 3 or color.dtype != np.uint8:
        raise TrocarError(f"a colour image needs shape (h, w, 3) of uint8, got {color.shape} of {color.dtype}")
    labels, count = _regions(ndimage.binary_closing(red_mask(color), np.ones((3, 3)), iterations=3))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    if not count or sizes.max() < MIN_BOARD_PIXELS:
        raise TrocarError("the image shows no red board; take it with the whole board in view and lit")
    largest = int(np.argmax(sizes))
    rows, columns = ndimage.find_objects(labels)[largest]
    smooth = ndimage.gaussian_filter(color.max(-1).astype(np.float64), 1.0)
    shade = (smooth / np.percentile(smooth[labels == largest + 1], BRIGHT_PERCENTILE))[rows, columns]
    pixels_per_m = (columns.stop - columns.start) / BOARD_WIDTH_M
    spots: list[NDArray[np.float64]] = []
    for limit in SHADES:
        for spot in _holes(shade, limit, pixels_per_m):
            if all(np.linalg.norm(spot - other) > SAME_BLOCK_M * pixels_per_m for other in spots):
                spots.append(spot)
    found = np.array(sorted(spots, key=lambda spot: spot[1])).reshape(-1, 2)
    return found + [columns.start, rows.start]


def _holes(shade: NDArray[np.float64], limit: float, pixels_per_m: float) -> list[NDArray[np.float64]]:
    """Return the centres u, v of shadows with a hole's size and shape and a lit rim."""
    labels, _ = _regions(shade < limit)
    inner, outer = (max(1, round(r * pixels_per_m)) for r in RIM_M)
    middles = []
    for index, (rows, columns) in enumerate(ndimage.find_objects(labels), 1):
        height, width = rows.stop - rows.start, columns.stop - columns.start
        if not HOLE_WIDTH_M[0] <= width / pixels_per_m <= HOLE_WIDTH_M[1] or height < MIN_ASPECT * width:
            continue
        if not HOLE_HEIGHT_M[0] <= height / pixels_per_m <= HOLE_HEIGHT_M[1]:
            continue
        window = np.s_[
            max(0, rows.start - outer) : rows.stop + outer, max(0, columns.start - outer) : columns.stop + outer
        ]
        spot = labels[window] == index
        rim = ndimage.binary_dilation(spot, iterations=outer) & np.logical_not(
            ndimage.binary_dilation(spot, iterations=inner)
        )
        area = spot.sum() / pixels_per_m**2
        if HOLE_AREA_M2[0] <= area <= HOLE_AREA_M2[1] and np.median(shade[window][rim]) >= MIN_RIM:
            middles.append(np.argwhere(spot).mean(0)[::-1] + [window[1].start, window[0].start])
    return middles


def _regions(mask: NDArray[np.bool_] | np.ndarray) -> tuple[NDArray[np.int32], int]:
    """Return the labels of connected regions, starting at 1, and their number."""
    labels = np.zeros(mask.shape, dtype=np.int32)
    return labels, int(ndimage.label(mask, output=labels))  # pyright: ignore[reportArgumentType]
