"""Shapes of a needle driver as the simulator draws and collides them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Instrument:
    """Solid shapes of an 8 mm instrument; estimated from photographs unless a source is named.

    Attributes:
        shaft_radius_m: da Vinci 8 mm instruments.
        shaft_length_m: visible from the wrist up to the drive.
        wrist_radius_m: clevis between the pitch and the yaw axis.
        knuckle_radius_m: boss of the jaws at the yaw axis.
        finger_length_m: yaw axis to the jaw's tip (facts/peg_transfer.md: .0102).
        finger_base_m: thickness of one finger at the yaw axis.
        finger_tip_m: thickness of one finger near its tip.
        finger_width_m: width of a finger along the yaw axis.
        tip_chamfer_m: length over which the tip's outer face is rounded off.
    """

    shaft_radius_m: float = 4.0e-3
    shaft_length_m: float = 0.40
    wrist_radius_m: float = 2.8e-3
    knuckle_radius_m: float = 2.2e-3
    finger_length_m: float = 10.2e-3
    finger_base_m: float = 1.9e-3
    finger_tip_m: float = 1.0e-3
    finger_width_m: float = 2.4e-3
    tip_chamfer_m: float = 1.0e-3

    def finger_m(self, side: int) -> NDArray[np.float64]:
        """Return the corner points (10, 3) of one finger, closed jaws, in its joint's frame.

        x points to the tip, y (times ``side``, +1 or -1) out of the closing plane, z along the yaw axis.
        """
        length, tip, chamfer = self.finger_length_m, self.finger_tip_m, self.tip_chamfer_m
        profile = [
            (0.0, 0.0),
            (length - 0.3 * chamfer, 0.0),
            (length, 0.3 * tip),
            (length - chamfer, tip),
            (0.0, self.finger_base_m),
        ]
        half = 0.5 * self.finger_width_m
        return np.array([(x, side * y, z) for x, y in profile for z in (-half, half)])
