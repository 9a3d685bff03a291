"""The phantom, and the stand on it that holds the needle before the first suture: blocks, as anybody can see them."""

from __future__ import annotations

import math

from trocar.geometry import SE3, SO3
from trocar.tasks.suture.needle import Needle

PHANTOM_M = (0.110, 0.110, 0.012)
"""Width, depth and thickness of the phantom; the circle is in the middle of its top."""
STAND_M = (0.018, 0.018, 0.006)
"""Width, depth and height of the block; its frame is in the middle of its top, z up."""
DEEP_M = 2.5e-3
"""How deep the needle is stuck into it."""
LOWEST_RAD = math.radians(20.0)
"""The point of the wire, behind its tip, that is deepest: the jaws come from above then."""


def T_stand_needle(needle: Needle) -> SE3:
    """Return where the needle stands in the foam: upright, its plane the stand's x-z plane."""
    upright = SO3.axis("x", math.pi / 2) @ SO3.axis("z", LOWEST_RAD)
    return SE3.from_parts(upright, [0.0, 0.0, needle.radius_m - DEEP_M])
