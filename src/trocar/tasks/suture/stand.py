"""Sizes of the phantom and of the stand that holds the needle before the first suture; agents may know them."""

from __future__ import annotations

import math

from trocar.geometry import SE3, SO3
from trocar.tasks.suture.needle import Needle

PHANTOM_M = (0.110, 0.110, 0.012)
"""Width, depth and thickness of the phantom; the circle is in the middle of its top."""
STAND_M = (0.018, 0.018, 0.006)
"""Width, depth and height of the stand; its frame is in the middle of its top, z up."""
DEEP_M = 2.5e-3
"""How deep the needle is stuck into the stand."""
LOWEST_RAD = math.radians(20.0)
"""Angle behind the needle's tip of the wire's deepest point, chosen so that the jaws come from above."""


def T_stand_needle(needle: Needle) -> SE3:
    """Return the pose of the needle in the stand: upright, its plane the stand's x-z plane."""
    upright = SO3.axis("x", math.pi / 2) @ SO3.axis("z", LOWEST_RAD)
    return SE3.from_parts(upright, [0.0, 0.0, needle.radius_m - DEEP_M])
