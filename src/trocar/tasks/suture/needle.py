"""A suture needle: a wire bent to an arc of a circle, round at both ends, and signed distances to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidValue
from trocar.geometry import TURN, shown, shown_scale


@dataclass(frozen=True)
class Needle:
    """A needle's shape; its frame has the origin at the centre of curvature, the tip at -y, the wire in the x-y plane.

    The wire runs clockwise about z from the tip to the tail, so that a needle turned by +z about its centre moves its
    tip along +x.

    Attributes:
        radius_m: radius of the wire's centreline.
        arc_rad: arc from tip to tail; 225 degrees is the 5/8 circle, which leaves room for two regrasps.
        wire_m: thickness of the wire.
    """

    radius_m: float = 0.0083
    arc_rad: float = math.radians(225.0)
    wire_m: float = 0.9e-3

    def __post_init__(self) -> None:
        check_range("needle radius", self.radius_m, 0.002, 0.05)
        check_range("needle arc", self.arc_rad, math.radians(60), math.radians(300), "rad")
        check_range("needle wire", self.wire_m, 0.1e-3, 2e-3)

    @property
    def p_tip_m(self) -> NDArray[np.float64]:
        """Return the needle's tip (3,) in its frame."""
        return np.array([0.0, -self.radius_m, 0.0])

    def behind_tip_rad(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angles (n,) behind the tip of those points of the wire that are nearest to points (n, 3)."""
        angle = np.arctan2(-p[:, 0], -p[:, 1])
        beyond = 0.5 * (TURN - self.arc_rad)  # half of the gap between the ends; beyond it the tail is nearer
        angle = (angle + beyond) % TURN - beyond
        return np.clip(angle, 0.0, self.arc_rad)

    def point_m(self, behind_tip_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (n, 3) of the wire's centreline at these angles (n,) behind the tip."""
        angle = np.asarray(behind_tip_rad, dtype=np.float64)
        return self.radius_m * np.stack([-np.sin(angle), -np.cos(angle), np.zeros_like(angle)], axis=-1)

    @property
    def outline_m(self) -> NDArray[np.float64]:
        """Return a closed line (n, 3) along the wire's inner and outer side."""
        angle = np.linspace(0.0, self.arc_rad, 40)
        middle, half = self.point_m(angle), 0.5 * self.wire_m / self.radius_m
        return np.concatenate([(1 + half) * middle, (1 - half) * middle[::-1]])

    def tangent(self, behind_tip_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit vectors (n, 3) along the wire, away from the tip."""
        angle = np.asarray(behind_tip_rad, dtype=np.float64)
        return np.stack([-np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)

    def distance_m(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed distances (n,) of points (n, 3) from the wire's surface."""
        away = p - self.point_m(self.behind_tip_rad(p))
        return np.linalg.norm(away, axis=1) - 0.5 * self.wire_m

    def slopes(self, p: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the signed distances (n,) of points (n, 3), and their derivatives (n, 6) by a twist of the needle.

        The twist is in the needle's frame: translation (m/m), then rotation (m/rad), as in ``SE3.exp``.
        """
        away = p - self.point_m(self.behind_tip_rad(p))
        length = np.linalg.norm(away, axis=1)
        normal = away / np.maximum(length, 1e-12)[:, None]
        by = np.concatenate([-normal, -np.cross(p, normal)], axis=1)
        return length - 0.5 * self.wire_m, np.asarray(by, dtype=np.float64)


def check_range(what: str, value: float, low: float, high: float, unit: str = "m") -> None:
    """Raise InvalidValue if a value is not finite or out of bounds; shown in mm or degrees as on the command line."""
    if not (math.isfinite(value) and low - 1e-12 <= value <= high + 1e-12):
        scale, _ = shown_scale(unit)
        raise InvalidValue(f"the {what}", shown(value, unit, "g"), f"give {scale * low:g} to {shown(high, unit, 'g')}")


def _by_length(length_m: float, circle: float) -> Needle:
    """Return the needle with this length along the wire and this share of a whole circle."""
    return Needle(length_m / (circle * TURN), circle * TURN)


NEEDLES = {
    "RB-1": _by_length(0.017, 1 / 2),
    "SH-1": _by_length(0.022, 1 / 2),
    "SH": _by_length(0.026, 1 / 2),
    "CT-2": _by_length(0.026, 1 / 2),
    "CT-1": _by_length(0.036, 1 / 2),
    "PS-2": _by_length(0.019, 3 / 8),
    "PS-1": _by_length(0.024, 3 / 8),
    "UR-6": _by_length(0.026, 5 / 8),
    "UR-5": _by_length(0.036, 5 / 8),
}
"""Needles by Ethicon's codes: length along the wire and share of a circle as printed on packages of sutures.

Packages do not state the thickness of the wire; it is the default (assumed).
"""
