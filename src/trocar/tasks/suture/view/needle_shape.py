"""A needle as triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.suture.planning import Needle
from trocar.view.mesh import Mesh, tube


def needle_arc_m(needle: Needle, corners: int = 49) -> NDArray[np.float64]:
    """Return the needle's centre line (k, 3) in its frame, from tip to tail."""
    angle = -np.linspace(0.0, needle.arc_rad, corners)
    return needle.radius_m * np.stack([np.sin(angle), -np.cos(angle), 0 * angle], -1)


def wire(needle: Needle) -> Mesh:
    """Return the needle, with a pointed tip, in its own frame."""
    line = needle_arc_m(needle)
    radii = np.full(len(line), needle.wire_m / 2)
    radii[:3] *= [0.05, 0.45, 0.85]
    return tube(line, radii, sides=12)
