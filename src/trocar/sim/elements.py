"""Elements of an MJCF text, and rules for what collides with what."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import ArrayLike

from trocar.geometry import SE3

SCENE_BIT = 1
ALL_BITS = 2**31 - 1
NOTHING = {"contype": "0", "conaffinity": "0"}
"""Attributes of a geom that is visible but collides with nothing."""
UNSEEN_GROUP = "4"
"""Group of geoms that no camera sees."""


def add(parent: Element, tag: str, **attributes: str) -> Element:
    """Return a new child."""
    return SubElement(parent, tag, attributes)


def text(values: ArrayLike) -> str:
    """Return numbers as an attribute, with all the digits that matter."""
    return " ".join(f"{v:.16g}" for v in np.atleast_1d(np.asarray(values, dtype=np.float64)).ravel())


def placed(T: SE3) -> dict[str, str]:
    """Return the attributes of a body at this pose in its parent."""
    return {"pos": text(T.translation_m), "quat": text(T.rotation.as_quaternion())}


def scene_bits() -> dict[str, str]:
    """Collide with the scene and every arm."""
    return {"contype": str(SCENE_BIT), "conaffinity": str(ALL_BITS)}


def arm_bits(index: int) -> dict[str, str]:
    """Collide with everything except the same instrument, whose neighbouring links overlap at their joints."""
    bit = SCENE_BIT << (index + 1)
    return {"contype": str(bit), "conaffinity": str(ALL_BITS & ~bit)}
