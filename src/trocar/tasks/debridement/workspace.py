"""What is known about the work surface beforehand: the receptacle's shape, and the region of the fragments."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Receptacle:
    """An open box on the work surface; its frame has the origin in the middle of its floor, z up, x along its length.

    Attributes:
        size_m: inner length and width; 11 x 7 cm (Kehoe 2014, VI).
        height_m: of its walls (assumed).
        wall_m: their thickness (assumed).
    """

    size_m: tuple[float, float] = (0.110, 0.070)
    height_m: float = 0.012
    wall_m: float = 0.002

    def holds(self, p_receptacle: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether points (..., 3) in the receptacle's frame lie between its walls, below their edge."""
        inside = np.abs(p_receptacle[..., :2]) < 0.5 * np.array(self.size_m)
        return inside.all(axis=-1) & (p_receptacle[..., 2] < self.height_m)


@dataclass(frozen=True)
class Workspace:
    """The plane work surface as given to an agent.

    Attributes:
        receptacle: shape of the receptacle; its pose is the fixture ``receptacle``.
        region_m: (2, 2) corners x, y in the world of the rectangle in which fragments may lie.
        fragment_m: smallest and largest extent of a fragment.
        fragments: maximum number of fragments.
    """

    receptacle: Receptacle = field(default_factory=Receptacle)
    region_m: tuple[tuple[float, float], tuple[float, float]] = ((-0.132, -0.092), (-0.017, -0.046))
    fragment_m: tuple[float, float] = (0.006, 0.016)
    fragments: int = 6
