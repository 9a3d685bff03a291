"""Solid shapes of an instrument: the single source for simulator, grasping, planning and view."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from trocar.checks import require_numbers
from trocar.errors import InvalidInput
from trocar.geometry import shown
from trocar.geometry.arrays import Array, finite

SLEEVE_M, SLEEVE_SHARE = (3e-3, 18e-3), 0.95
"""Steel sleeve at the shaft's end: its extent behind the wrist pitch axis, and its radius as a share of the shaft's."""
CLEVIS_SHARE = 0.75  # the round part of the clevis ends at this share of the way to the yaw axis
KNUCKLE_SHARE = 0.9  # width of the boss at the yaw axis, as a share of a finger's width


@dataclass(frozen=True)
class FingerMarks:
    """Two marks of one colour on each finger, by which a camera finds the jaws (Kehoe 2014, V-A.2).

    A mark is a disc through the finger, slightly thicker than it, so that it shows on both sides. Its rim extends
    beyond the finger's back.
    """

    # linear RGB in [0, 1] of the left finger's marks and of the right one's
    colors: tuple[tuple[float, float, float], tuple[float, float, float]]
    along_m: tuple[float, float] = (7.0e-3, 14.5e-3)  # of the two marks' middles from the yaw axis, along the finger
    behind_m: float = 1.7e-3  # of their middles, behind the plane in which closed jaws meet
    radius_m: float = 1.6e-3  # of a mark
    proud_m: float = 0.3e-3  # how far it stands out on both sides of the finger, along the yaw axis

    def __post_init__(self) -> None:
        require_numbers(self)

    def centers_m(self, side: int, jaw_rad: float) -> Array:
        """Return the marks' centres (2, 3) on the left (+1) or right (-1) finger, in the frame of ``finger_m``."""
        half = 0.5 * side * jaw_rad
        along, behind = np.array(self.along_m), side * self.behind_m
        x = np.cos(half) * along - np.sin(half) * behind
        y = np.sin(half) * along + np.cos(half) * behind
        return np.stack([x, y, np.zeros(2)], axis=-1)


@dataclass(frozen=True)
class Instrument:
    """An instrument with two fingers; shaft, wrist and jaws as solids.

    The kinematic lengths (``wrist_length_m``, ``tip_length_m``) and the range of the jaws belong to ``ArmModel``, for
    the inverse kinematics. Sizes are estimated from photographs unless a source is named.

    Attributes:
        name: what it is sold or known as.
        shaft_radius_m: of the shaft.
        shaft_length_m: from the wrist pitch axis back to the drive unit.
        wrist_radius_m: clevis between the pitch and the yaw axis.
        knuckle_radius_m: boss of the jaws at the yaw axis.
        finger_length_m: from the yaw axis to the end of the jaws.
        finger_base_m: thickness of one finger at the yaw axis.
        finger_tip_m: thickness of one finger near its end.
        finger_width_m: width of a finger along the yaw axis.
        tip_chamfer_m: length over which the outer face of the end is rounded off.
        marks: colour marks on its fingers; None: it has none.
    """

    name: str
    shaft_radius_m: float
    shaft_length_m: float
    wrist_radius_m: float
    knuckle_radius_m: float
    finger_length_m: float
    finger_base_m: float
    finger_tip_m: float
    finger_width_m: float
    tip_chamfer_m: float
    marks: FingerMarks | None = None

    def __post_init__(self) -> None:
        sizes = {f.name: getattr(self, f.name) for f in fields(self) if f.name.endswith("_m")}
        finite(f"instrument {self.name!r}", list(sizes.values()), len(sizes))
        small = [name for name, size in sizes.items() if not size > 0]
        if small:
            problem = f"of instrument {self.name!r} is {sizes[small[0]]}"
            raise InvalidInput(small[0], problem, "give a length above 0")
        if not self.tip_chamfer_m < self.finger_length_m:
            long = f"are {self.finger_length_m} m long, and the chamfer at their end {self.tip_chamfer_m} m"
            raise InvalidInput("the fingers", f"of instrument {self.name!r} {long}", "give a shorter one")

    def __repr__(self) -> str:
        shaft, fingers = shown(2 * self.shaft_radius_m, "m", "g"), shown(self.finger_length_m, "m", "g")
        return f"<Instrument {self.name!r}: shaft {shaft} thick, fingers {fingers} long>"

    def finger_m(self, side: int) -> Array:
        """Return the corner points (10, 3) of one finger of closed jaws, in the frame of its joint.

        x points to the end of the jaws, y (times ``side``, +1 or -1) out of the closing plane, z along the yaw axis.
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

    def finger_thickness_m(self, from_end_m: float) -> float:
        """Return the thickness of one finger this far back from its end, at the chamfer or behind it."""
        behind = max(0.0, from_end_m - self.tip_chamfer_m) / (self.finger_length_m - self.tip_chamfer_m)
        return self.finger_tip_m + behind * (self.finger_base_m - self.finger_tip_m)

    @property
    def finger_radius_m(self) -> float:
        """Return the radius of a capsule that contains the whole finger."""
        return float(np.hypot(self.finger_base_m, 0.5 * self.finger_width_m))


LARGE_NEEDLE_DRIVER = Instrument(
    name="da Vinci Large Needle Driver 400006, 8 mm",
    shaft_radius_m=4.0e-3,  # 8 mm instruments
    shaft_length_m=0.40,
    wrist_radius_m=2.8e-3,
    knuckle_radius_m=2.2e-3,
    finger_length_m=10.2e-3,  # Large Needle Driver, wrist yaw axis to the jaws' tip
    finger_base_m=1.9e-3,
    finger_tip_m=1.0e-3,
    finger_width_m=2.4e-3,
    tip_chamfer_m=1.0e-3,
)

RAVEN_GRIPPER = Instrument(
    name="Raven II gripper",
    shaft_radius_m=4.0e-3,  # an 8 mm shaft
    shaft_length_m=0.47,  # d4 of the modified DH
    wrist_radius_m=3.2e-3,
    knuckle_radius_m=2.8e-3,
    finger_length_m=20.0e-3,  # the jaws end 20 mm beyond the jaw axis
    finger_base_m=2.4e-3,
    finger_tip_m=1.2e-3,
    finger_width_m=3.6e-3,
    tip_chamfer_m=1.6e-3,
)
