"""The solids of an arm's instrument, link by link; the simulator and exported models are built from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.arms.forward import frames
from trocar.arms.instrument import CLEVIS_SHARE, KNUCKLE_SHARE, SLEEVE_M, SLEEVE_SHARE
from trocar.arms.model import ArmModel

STEEL = (0.62, 0.63, 0.66)
CARBON = (0.10, 0.11, 0.13)
HOUSING = (0.55, 0.56, 0.60)
DRIVE_M = (0.06, 0.09, 0.08)
"""Size of the drive unit behind the shaft (assumed)."""


@dataclass(frozen=True, eq=False)
class Part:
    """One solid, in the frame of the link that carries it.

    Attributes:
        name: what it is.
        link: number of that frame, 1 to 6 (modified DH).
        shape: a capsule's caps go beyond its ends.
        at_m: (2, 3) ends of the axis of a cylinder or capsule; (1, 3) middle of a box, whose sides are along x, y, z.
        size_m: radius of a cylinder or capsule; three sides of a box.
        rgb: colour, each in [0, 1].
    """

    name: str
    link: int
    shape: Literal["cylinder", "capsule", "box"]
    at_m: NDArray[np.float64]
    size_m: tuple[float, ...]
    rgb: tuple[float, float, float]


def parts_of(arm: ArmModel) -> tuple[Part, ...]:
    """Return all solids of an arm's instrument except its fingers (``Instrument.finger_m``), which the jaws move.

    The shaft is attached to the roll link, whose origin is on the pitch axis and whose z runs along the shaft.
    """
    shape, back = arm.instrument, float(arm.wrist_sign)  # from the wrist towards the remote centre
    at_zero = frames(arm, np.zeros(6))
    wrist_m = (at_zero[5].inverse() @ at_zero[6]).translation_m
    length, half = shape.shaft_length_m, 0.5 * KNUCKLE_SHARE * shape.finger_width_m
    sleeve = (shape.shaft_radius_m * SLEEVE_SHARE,)
    return (
        Part("sleeve", 4, "cylinder", _along_z(*(back * z for z in SLEEVE_M)), sleeve, STEEL),
        Part(
            "shaft",
            4,
            "cylinder",
            _along_z(back * (SLEEVE_M[1] + 1e-3), back * length),
            (shape.shaft_radius_m,),
            CARBON,
        ),
        Part("drive", 4, "box", _along_z(back * (length + 0.5 * DRIVE_M[2])), DRIVE_M, HOUSING),
        Part("wrist", 5, "capsule", np.array([np.zeros(3), CLEVIS_SHARE * wrist_m]), (shape.wrist_radius_m,), STEEL),
        Part("knuckle", 6, "cylinder", _along_z(half, -half), (shape.knuckle_radius_m,), STEEL),
    )


def _along_z(*z: float) -> NDArray[np.float64]:
    return np.array([[0.0, 0.0, value] for value in z])
