"""The geometry of a suture task: arm, circle on the tissue, needle, grasp, and how the needle is driven."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trocar.arms import PSM_CLASSIC, ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3, TURN, shown, shown_scale

CLOCKWISE, COUNTERCLOCKWISE = 1, -1
DIRECTIONS = (CLOCKWISE, COUNTERCLOCKWISE)
"""The paper's d (section III-B), as seen from above the tissue; the direction axis of every array has this order."""

DIRECTION_NAMES = {CLOCKWISE: "clockwise", COUNTERCLOCKWISE: "counterclockwise"}

HOLDABLE_RAD = math.radians(5.0)
"""Flat jaws straighten a wire that leaves their plane by no more than this (assumed)."""


@dataclass(frozen=True)
class Circle:
    """The circle of sutures round the defect.

    Attributes:
        radius_m: radius (the paper gives none; 30 mm fits a da Vinci training phantom).
        T_world_circle: pose: z out of the tissue, theta counterclockwise from x.
    """

    radius_m: float = 0.030
    T_world_circle: SE3 = field(default_factory=SE3.identity)

    def __post_init__(self) -> None:
        _within("circle radius", self.radius_m, 0.002, 0.2)


@dataclass(frozen=True)
class Needle:
    """A needle bent to an arc of a circle.

    Attributes:
        radius_m: radius of curvature.
        arc_rad: angle from tip to tail; 225 degrees is the 5/8 circle, which leaves room for two regrasps.
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
    of the needle's plane) the orientation of the arm's tip is ``Rx(approach) P Rx(lean) Rz(skew)``, where P aligns the
    jaw axis with the wire, the jaws pointing at the needle's centre.

    Attributes:
        behind_tip_rad: arc from the needle's tip back to the jaws.
        approach_rad: rotation of the jaws about the wire; at 0 they come from outside, in the needle's plane.
        lean_rad: rotation of the jaws about the direction in which they close.
        skew_rad: rotation of the jaws about their long axis; at 0 or half a turn the wire lies in the plane in which
            the fingers meet.
    """

    behind_tip_rad: float = math.radians(120.0)
    approach_rad: float = 0.0
    lean_rad: float = 0.0
    skew_rad: float = 0.0

    def __post_init__(self) -> None:
        _within("grasp behind the tip", self.behind_tip_rad, 0.0, math.radians(300), "rad")
        for name in ("approach_rad", "lean_rad", "skew_rad"):
            _within(f"grasp {name.removesuffix('_rad')}", getattr(self, name), -TURN, TURN, "rad")

    @property
    def rotation(self) -> SO3:
        """Return the orientation of the arm's tip in the frame of the grasped point."""
        along = SO3(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]))
        turned = SO3.axis("x", self.approach_rad) @ along @ SO3.axis("x", self.lean_rad)
        return turned @ SO3.axis("z", self.skew_rad)

    @property
    def out_of_jaws_rad(self) -> float:
        """Return the angle between the wire and the plane in which the fingers meet; closing jaws force it to 0."""
        return math.asin(min(1.0, abs(float(self.rotation.matrix[0, 0]))))

    @property
    def holdable(self) -> bool:
        """Return whether flat jaws can hold the wire in this grasp."""
        return self.out_of_jaws_rad <= HOLDABLE_RAD


@dataclass(frozen=True)
class Insertion:
    """The parameters of the needle primitive (paper, Fig. 2); those that the paper leaves open are marked.

    Attributes:
        entry_angle_rad: angle between the needle's initial direction and the tissue's surface.
        straight_m: length of the straight penetration.
        rotation_rad: rotation about the needle's centre that follows.
        regrasp_rad: angle by which the jaws move back along the needle, and then push it on (open in the paper).
        pushes: how often they do so.
        theta_is: which point of the suture lies at theta: ``entry``, or ``middle`` of the bite (open in the paper).
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
        """Return the total rotation of the needle about its centre."""
        return self.rotation_rad + self.pushes * self.regrasp_rad

    def exit_turn_rad(self, needle_radius_m: float) -> float:
        """Return the rotation at which a needle's tip leaves the tissue's surface again; NaN if it never would."""
        cosine = math.cos(self.entry_angle_rad) - self.straight_m * math.sin(self.entry_angle_rad) / needle_radius_m
        return self.entry_angle_rad + math.acos(cosine) if cosine >= -1.0 else math.nan


@dataclass(frozen=True)
class SutureSetup:
    """The complete geometry of a suture task.

    Attributes:
        arm: the arm that sutures; its tip is the point where the jaws hold the needle.
        T_world_base: pose of its base (remote centre).
        circle: the circle of sutures.
        needle: the needle.
        grasp: how the jaws hold it.
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
                f"a needle of radius {shown(self.needle.radius_m, 'm')} is too large for a circle of radius "
                f"{shown(self.circle.radius_m, 'm')}: its diameter may be at most the circle's radius; give a needle "
                f"radius up to {shown(self.circle.radius_m / 2, 'm')} or a larger circle"
            )
        last = self.grasp.behind_tip_rad + self.insertion.pushes * self.insertion.regrasp_rad
        if last > self.needle.arc_rad + 1e-9:
            raise TrocarError(
                f"the last grasp lies {shown(last, 'rad', '.0f')} behind the needle's tip, beyond its tail at "
                f"{shown(self.needle.arc_rad, 'rad', '.0f')}; grasp nearer to the tip, regrasp less or take a "
                "longer needle"
            )
        insertion = self.insertion
        if insertion.theta_is == "middle" and math.isnan(insertion.exit_turn_rad(self.needle.radius_m)):
            raise TrocarError(
                f"after {shown(insertion.straight_m, 'm', 'g')} straight at "
                f"{shown(insertion.entry_angle_rad, 'rad', 'g')} a needle of radius "
                f"{shown(self.needle.radius_m, 'm', 'g')} never comes out, so its suture has no middle; let theta "
                "be the entry, shorten the straight path or lower the entry angle"
            )

    def __repr__(self) -> str:
        return (
            f"<SutureSetup: circle of radius {shown(self.circle.radius_m, 'm')}, needle of radius "
            f"{shown(self.needle.radius_m, 'm')}, {self.arm.name} at {self.T_world_base!r}>"
        )

    @property
    def T_base_circle(self) -> SE3:
        """Return the circle's pose in the arm's base."""
        return self.T_world_base.inverse() @ self.circle.T_world_circle


def base_beside(
    azimuth_rad: float, sideways_m: float, up_m: float, tilt_rad: float = 0.0, spin_rad: float = 0.0
) -> SE3:
    """Return the pose of a base beside and above the world's origin, with rotation ``Rz(azimuth) Ry(tilt) Rz(spin)``.

    Args:
        azimuth_rad: direction from the origin to the base, counterclockwise from x.
        sideways_m: horizontal distance.
        up_m: height.
        tilt_rad: lean of the instrument (at rest along -z of the base) towards the origin.
        spin_rad: rotation of the base about its z.
    """
    for name, value, bound in (("sideways", sideways_m, 0.5), ("up", up_m, 0.5)):
        _within(f"base {name}", value, -bound, bound)
    for name, value in (("azimuth", azimuth_rad), ("tilt", tilt_rad), ("spin", spin_rad)):
        if not math.isfinite(value):
            raise TrocarError(f"the base {name} is {shown(value, 'rad', 'g')}; give a finite angle")
    place = [sideways_m * math.cos(azimuth_rad), sideways_m * math.sin(azimuth_rad), up_m]
    return SE3.from_parts(SO3.axis("z", azimuth_rad) @ SO3.axis("y", tilt_rad) @ SO3.axis("z", spin_rad), place)


def _within(what: str, value: float, low: float, high: float, unit: str = "m") -> None:
    """Raise TrocarError if a value is not finite or out of bounds; shown in mm or degrees as on the command line."""
    if not (math.isfinite(value) and low - 1e-12 <= value <= high + 1e-12):
        scale, _ = shown_scale(unit)
        raise TrocarError(f"the {what} is {shown(value, unit, 'g')}; give {scale * low:g} to {shown(high, unit, 'g')}")
