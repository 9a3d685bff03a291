"""What is given: the arm, the circle on the tissue, the needle, how it is grasped and how it is driven."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trocar.arms import PSM_CLASSIC, ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3

CLOCKWISE, COUNTERCLOCKWISE = 1, -1
DIRECTIONS = (CLOCKWISE, COUNTERCLOCKWISE)
"""The paper's d (section III-B), as seen from above the tissue; the order of every array's direction axis."""

HOLDABLE_RAD = math.radians(5.0)
"""Flat jaws turn a wire straight that leaves their plane by no more than this (assumed)."""


@dataclass(frozen=True)
class Circle:
    """The circle round the defect on which the sutures stand.

    Attributes:
        radius_m: of the circle (the paper gives none; 30 mm fits a da Vinci training phantom).
        T_world_circle: pose of the circle: z out of the tissue, theta counterclockwise from x.
    """

    radius_m: float = 0.030
    T_world_circle: SE3 = field(default_factory=SE3.identity)

    def __post_init__(self) -> None:
        _within("circle radius", self.radius_m, 0.002, 0.2)


@dataclass(frozen=True)
class Needle:
    """A needle bent to an arc of a circle.

    Attributes:
        radius_m: of its curvature.
        arc_rad: from tip to tail; 225 degrees is the 5/8 circle, which leaves room for two regrasps.
        wire_m: thickness of the wire.
    """

    radius_m: float = 0.0083
    arc_rad: float = math.radians(225.0)
    wire_m: float = 0.9e-3

    def __post_init__(self) -> None:
        _within("needle radius", self.radius_m, 0.002, 0.05)
        _within("needle arc", self.arc_rad, math.radians(60), math.radians(300), "rad")
        _within("needle wire", self.wire_m, 0.1e-3, 2e-3)


@dataclass(frozen=True)
class NeedleGrasp:
    """How the jaws hold the needle: a constant of the primitive (paper, III-C2).

    In the frame of the grasped point (x along the wire to the needle's tip, y to the needle's centre, z the normal
    of the needle's plane) the arm's tip is turned by ``Rx(approach) P Rx(lean) Rz(skew)``, where P lays the jaw axis
    along the wire, with the jaws pointing at the needle's centre.

    Attributes:
        behind_tip_rad: arc from the needle's tip back to the jaws.
        approach_rad: turn of the jaws about the wire; 0 comes from outside in the needle's plane.
        lean_rad: turn of the jaws about the direction in which they close.
        skew_rad: turn about the jaws' length; 0 or half a turn lays the wire into the plane in which the fingers meet.
    """

    behind_tip_rad: float = math.radians(120.0)
    approach_rad: float = 0.0
    lean_rad: float = 0.0
    skew_rad: float = 0.0

    def __post_init__(self) -> None:
        _within("grasp behind the tip", self.behind_tip_rad, 0.0, math.radians(300), "rad")
        for name in ("approach_rad", "lean_rad", "skew_rad"):
            _within(f"grasp {name.removesuffix('_rad')}", getattr(self, name), -2 * math.pi, 2 * math.pi, "rad")

    @property
    def rotation(self) -> SO3:
        """Return the orientation of the arm's tip in the frame of the grasped point."""
        along = SO3(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]))
        turned = SO3.axis("x", self.approach_rad) @ along @ SO3.axis("x", self.lean_rad)
        return turned @ SO3.axis("z", self.skew_rad)

    @property
    def out_of_jaws_rad(self) -> float:
        """Return the angle between the wire and the plane in which the fingers meet; closing jaws make it 0."""
        return math.asin(min(1.0, abs(float(self.rotation.matrix[0, 0]))))

    @property
    def holdable(self) -> bool:
        """Return whether flat jaws can hold a wire so."""
        return self.out_of_jaws_rad <= HOLDABLE_RAD


@dataclass(frozen=True)
class Insertion:
    """The needle primitive's numbers (paper, Fig. 2); those that the paper leaves open say so.

    Attributes:
        entry_angle_rad: between the needle's first direction and the tissue's surface.
        straight_m: path of the straight penetration.
        rotation_rad: turn about the needle's centre that follows.
        regrasp_rad: how far the jaws go back along the needle, and then push it on (open in the paper).
        pushes: how often they do so.
        theta_is: which point of the suture stands at theta: ``entry``, or ``middle`` of the bite (open in the paper).
    """

    entry_angle_rad: float = math.radians(30.0)
    straight_m: float = 0.010
    rotation_rad: float = math.radians(70.0)
    regrasp_rad: float = math.radians(35.0)
    pushes: int = 2
    theta_is: str = "entry"

    def __post_init__(self) -> None:
        _within("entry angle", self.entry_angle_rad, 0.0, math.pi / 2, "rad")
        _within("straight path", self.straight_m, 0.0, 0.05)
        _within("rotation", self.rotation_rad, 0.0, math.pi, "rad")
        _within("regrasp angle", self.regrasp_rad, 0.0, math.pi, "rad")
        if self.pushes not in range(11):
            raise TrocarError(f"the number of pushes is {self.pushes}; give 0 to 10")
        if self.theta_is not in ("entry", "middle"):
            raise TrocarError(f"theta is the {self.theta_is!r} of a suture; choose entry or middle")

    @property
    def turn_rad(self) -> float:
        """Return how far the needle is turned in all about its centre."""
        return self.rotation_rad + self.pushes * self.regrasp_rad

    def exit_turn_rad(self, needle_radius_m: float) -> float:
        """Return the turn at which a needle's tip comes out of the tissue's plane; NaN if it never would."""
        cosine = math.cos(self.entry_angle_rad) - self.straight_m * math.sin(self.entry_angle_rad) / needle_radius_m
        return self.entry_angle_rad + math.acos(cosine) if cosine >= -1.0 else math.nan


@dataclass(frozen=True)
class SutureSetup:
    """Everything that the geometry of a plan depends on.

    Attributes:
        arm: who sutures; its tip is where the jaws hold the needle.
        T_world_base: pose of its base (remote centre).
        circle: where.
        needle: with what.
        grasp: how it is held.
        insertion: how it is driven.
    """

    arm: ArmModel = PSM_CLASSIC
    T_world_base: SE3 = field(default_factory=lambda: base_beside(math.radians(225.0), 0.050, 0.100))
    circle: Circle = field(default_factory=Circle)
    needle: Needle = field(default_factory=Needle)
    grasp: NeedleGrasp = field(default_factory=NeedleGrasp)
    insertion: Insertion = field(default_factory=Insertion)

    def __post_init__(self) -> None:
        if 2 * self.needle.radius_m > self.circle.radius_m:
            raise TrocarError(
                f"a needle of radius {1e3 * self.needle.radius_m:.1f} mm is too large for a circle of radius "
                f"{1e3 * self.circle.radius_m:.1f} mm: its diameter may be at most the circle's radius; give a needle "
                f"radius up to {500 * self.circle.radius_m:.1f} mm or a larger circle"
            )
        last = self.grasp.behind_tip_rad + self.insertion.pushes * self.insertion.regrasp_rad
        if last > self.needle.arc_rad + 1e-9:
            raise TrocarError(
                f"the last grasp lies {math.degrees(last):.0f} deg behind the needle's tip, beyond its tail at "
                f"{math.degrees(self.needle.arc_rad):.0f} deg; grasp nearer to the tip, regrasp less or take a "
                "longer needle"
            )
        insertion = self.insertion
        if insertion.theta_is == "middle" and math.isnan(insertion.exit_turn_rad(self.needle.radius_m)):
            raise TrocarError(
                f"after {1e3 * insertion.straight_m:g} mm straight at {math.degrees(insertion.entry_angle_rad):g} deg "
                f"a needle of radius {1e3 * self.needle.radius_m:g} mm never comes out: its suture has no middle; "
                "let theta be the entry, go less far straight or less steeply"
            )

    @property
    def T_base_circle(self) -> SE3:
        """Return the circle's pose in the arm's base."""
        return self.T_world_base.inverse() @ self.circle.T_world_circle


def base_beside(
    azimuth_rad: float, sideways_m: float, up_m: float, tilt_rad: float = 0.0, spin_rad: float = 0.0
) -> SE3:
    """Return a base ``Rz(azimuth) Ry(tilt) Rz(spin)`` beside and above the world's origin.

    Args:
        azimuth_rad: direction from the origin to the base, counterclockwise from x.
        sideways_m: horizontal distance.
        up_m: height.
        tilt_rad: lean of the instrument (at rest along -z of the base) towards the origin.
        spin_rad: turn of the base about its z.
    """
    for name, value, bound in (("sideways", sideways_m, 0.5), ("up", up_m, 0.5)):
        _within(f"base {name}", value, -bound, bound)
    for name, value in (("azimuth", azimuth_rad), ("tilt", tilt_rad), ("spin", spin_rad)):
        if not math.isfinite(value):
            raise TrocarError(f"the base {name} is {math.degrees(value):g} deg; give a finite angle")
    place = [sideways_m * math.cos(azimuth_rad), sideways_m * math.sin(azimuth_rad), up_m]
    return SE3.from_parts(SO3.axis("z", azimuth_rad) @ SO3.axis("y", tilt_rad) @ SO3.axis("z", spin_rad), place)


def _within(what: str, value: float, low: float, high: float, unit: str = "m") -> None:
    """Raise a sentence if a value is not finite or out of bounds; shown in mm or degrees as on the command line."""
    scale, shown = (1e3, "mm") if unit == "m" else (180 / math.pi, "deg")
    if not (math.isfinite(value) and low - 1e-12 <= value <= high + 1e-12):
        raise TrocarError(f"the {what} is {scale * value:g} {shown}; give {scale * low:g} to {scale * high:g} {shown}")
