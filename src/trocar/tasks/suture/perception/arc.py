"""Signed distances to a needle: a wire bent to an arc of a circle, round at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import TURN


@dataclass(frozen=True)
class NeedleArc:
    """A needle's shape; its frame has the origin at the centre of curvature, the tip at -y, the wire in the x-y plane.

    The wire runs clockwise about z from the tip to the tail, so that a needle turned by +z about its centre moves its
    tip along +x.

    Attributes:
        radius_m: of the wire's middle line.
        arc_rad: from tip to tail.
        wire_m: thickness of the wire.
    """

    radius_m: float
    arc_rad: float
    wire_m: float

    def __post_init__(self) -> None:
        if not (0.0 < self.wire_m < self.radius_m and 0.0 < self.arc_rad <= TURN):
            raise TrocarError(
                f"a needle of radius {self.radius_m!r} m, arc {self.arc_rad!r} rad and wire {self.wire_m!r} m has no "
                "shape; give a wire thinner than the radius and an arc of at most a turn"
            )

    def behind_tip_rad(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far (n,) behind the tip the points of the wire lie that are nearest to points (n, 3)."""
        angle = np.arctan2(-p[:, 0], -p[:, 1])
        beyond = 0.5 * (TURN - self.arc_rad)  # half of the gap between the ends, beyond which the other end is nearer
        angle = (angle + beyond) % TURN - beyond
        return np.clip(angle, 0.0, self.arc_rad)

    def point_m(self, behind_tip_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (n, 3) of the wire's middle line at these arc lengths (n,) behind the tip."""
        angle = np.asarray(behind_tip_rad, dtype=np.float64)
        return self.radius_m * np.stack([-np.sin(angle), -np.cos(angle), np.zeros_like(angle)], axis=-1)

    def tangent(self, behind_tip_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit vectors (n, 3) along the wire, away from the tip."""
        angle = np.asarray(behind_tip_rad, dtype=np.float64)
        return np.stack([-np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)

    def distance_m(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed distances (n,) of points (n, 3) from the wire's surface."""
        away = p - self.point_m(self.behind_tip_rad(p))
        return np.linalg.norm(away, axis=1) - 0.5 * self.wire_m

    def slopes(self, p: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the distances (n,) of points (n, 3), and their derivatives (n, 6) by a twist of the needle.

        The twist is in its frame, a translation (m/m) and a rotation (m/rad), as in ``SE3.exp``.
        """
        away = p - self.point_m(self.behind_tip_rad(p))
        length = np.linalg.norm(away, axis=1)
        normal = away / np.maximum(length, 1e-12)[:, None]
        by = np.concatenate([-normal, -np.cross(p, normal)], axis=1)
        return length - 0.5 * self.wire_m, np.asarray(by, dtype=np.float64)
