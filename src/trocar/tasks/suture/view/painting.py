"""Rewards of sutures, painted as a flat picture on the tissue.

The browser shows pictures in their own colours. It shades meshes and lines, so a colour scale could not be read off
them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from trocar.geometry import TURN
from trocar.tasks.suture.planning.rewards import DexterityMap

Colour = tuple[int, int, int]

COLOURS = "viridis"  # as in the figures of reports
INK, BLOCKED = (34, 34, 34), (205, 205, 205)
RING, GAP = 0.17, 0.03  # width of a ring, and gap between the two, as shares of the rings' inner radius; as in plan.png
PIXELS, FINER = 1000, 2  # pixels per side, and factor by which it is painted finer to smooth edges
ARROW_M = 0.0022  # width of an arrow's shaft


@dataclass(frozen=True)
class Scale:
    """A colour scale for rewards.

    Attributes:
        low: reward with the darkest colour.
        high: reward with the brightest colour.
    """

    low: float
    high: float

    def colour(self, reward: float) -> Colour:
        """Return the colour of a reward."""
        share = (reward - self.low) / (self.high - self.low) if self.high > self.low else 1.0
        red, green, blue, _ = mpl.colormaps[COLOURS](min(max(share, 0.0), 1.0), bytes=True)
        return int(red), int(green), int(blue)

    def bar(self) -> NDArray[np.uint8]:
        """Return a picture (h, w, 3) of the scale, from low to high."""
        return np.tile(mpl.colormaps[COLOURS](np.linspace(0.0, 1.0, 256), bytes=True)[None, :, :3], (16, 1, 1))


@dataclass(frozen=True, eq=False)
class Painting:
    """A square picture centred on the circle.

    Attributes:
        rgba: (k, k, 4) columns along x, rows along y of the circle's frame.
        side_m: length of a side.
    """

    rgba: NDArray[np.uint8]
    side_m: float

    def at(self, x_m: float, y_m: float) -> NDArray[np.uint8]:
        """Return the colour (4,) at a point."""
        row, column = (int((at / self.side_m + 0.5) * len(self.rgba)) for at in (y_m, x_m))
        return self.rgba[row, column]


def ring_radii_m(arrows_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return inner and outer radius (2, 2) of the rings of clockwise and of counterclockwise sutures.

    Args:
        arrows_m: (m, 2, 2) start and end of the sutures, which the rings enclose.
    """
    inner = 1.1 * np.linalg.norm(arrows_m, axis=-1).max()
    return inner * np.array([[1 + RING + GAP, 1 + 2 * RING + GAP], [1.0, 1 + RING]])


def paint(arrows_m: NDArray[np.float64], rewards: Sequence[float], scale: Scale, map: DexterityMap | None) -> Painting:
    """Paint the sutures of a plan as arrows from entry to exit, surrounded by rings for sutures at all positions.

    Args:
        arrows_m: (m, 2, 2) start and end of the sutures.
        rewards: (m,) rewards of the sutures.
        scale: colour scale.
        map: dexterity of all sutures, clockwise ones in the outer ring, grey where out of reach; None: no rings.
    """
    radii = ring_radii_m(arrows_m)
    side = 2.02 * radii.max()
    pixels = PIXELS * FINER
    rgba = np.zeros((pixels, pixels, 4), np.uint8)
    if map is not None:
        _paint_rings(rgba, side, radii, map, scale.colour)
    canvas = Image.fromarray(rgba)
    pen = ImageDraw.Draw(canvas)
    for arrow, reward in zip(arrows_m, rewards, strict=True):
        outline = [tuple(point) for point in ((_arrow(*arrow) / side + 0.5) * pixels).tolist()]
        pen.polygon(outline, fill=(*scale.colour(reward), 255), outline=(*INK, 255), width=2 * FINER)
    return Painting(np.asarray(canvas.resize((PIXELS, PIXELS), Image.Resampling.BOX)), side)


def _paint_rings(
    rgba: NDArray[np.uint8],
    side_m: float,
    radii_m: NDArray[np.float64],
    map: DexterityMap,
    colour: Callable[[float], Colour],
) -> None:
    """Paint both rings, with a cell centred at each position."""
    pixels, n = len(rgba), len(map.thetas_rad)
    along = ((np.arange(pixels) + 0.5) / pixels - 0.5) * side_m
    distance = np.hypot(along[None], along[:, None])
    cell = np.rint(np.arctan2(along[:, None], along[None]) * (n / TURN)).astype(int) % n
    for row, (inner, outer) in enumerate(radii_m):
        cells = [
            colour(reward) if feasible else BLOCKED
            for reward, feasible in zip(map.values[row].tolist(), map.joints.feasible[row], strict=True)
        ]
        within = (inner <= distance) & (distance < outer)
        rgba[within, :3] = np.array(cells, np.uint8)[cell[within]]
        rgba[within, 3] = 255


def _arrow(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (7, 2) of an arrow."""
    length = float(np.linalg.norm(end - start))
    ahead = (end - start) / length
    left = np.array([-ahead[1], ahead[0]])
    half, head = ARROW_M / 2, 1.3 * ARROW_M
    neck = end - ahead * min(length / 2, 2.2 * ARROW_M)
    right_side = [start - half * left, neck - half * left, neck - head * left]
    return np.array([*right_side, end, neck + head * left, neck + half * left, start + half * left])
