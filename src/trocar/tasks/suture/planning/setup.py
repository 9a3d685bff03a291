"""The geometry of a suture task: arm, circle and mesh, needle, grasp, insertion, body wall and second port."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import PSM_CLASSIC, ArmModel
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.tasks.suture.needle import Needle, check_range

CLOCKWISE, COUNTERCLOCKWISE = 1, -1
DIRECTIONS = (CLOCKWISE, COUNTERCLOCKWISE)
"""The paper's d (section III-B), as seen from above the tissue; the direction axis of every array has this order."""
DIRECTION_NAMES = {CLOCKWISE: "clockwise", COUNTERCLOCKWISE: "counterclockwise"}

HOLDABLE_RAD = math.radians(5.0)
"""Flat jaws straighten a wire that leaves their plane by no more than this (assumed)."""


@dataclass(frozen=True)
class Circle:
    """The circle of sutures that holds a mesh over a defect.

    The paper gives no sizes: the circle fits a da Vinci training phantom; mesh and defect are assumed.

    Attributes:
        radius_m: radius.
        T_world_circle: z out of the tissue, theta counterclockwise from x.
        mesh_beyond_m: how far the mesh's edge lies outside of the circle.
        mesh_margin_m: how far all of a bite must stay from the mesh's edge, so that the suture holds the mesh.
        defect_within_m: how far the edge of the defect lies inside of the circle; if the circle is smaller than this,
            there is no defect.
    """

    radius_m: float = 0.030
    T_world_circle: SE3 = field(default_factory=SE3.identity)
    mesh_beyond_m: float = 0.005
    mesh_margin_m: float = 0.001
    defect_within_m: float = 0.015

    def __post_init__(self) -> None:
        check_range("circle radius", self.radius_m, 0.002, 0.2)
        check_range("mesh beyond the circle", self.mesh_beyond_m, 0.0, 0.1)
        check_range("margin to the mesh's edge", self.mesh_margin_m, 0.0, 0.1)
        check_range("defect within the circle", self.defect_within_m, 0.0, 0.2)

    @property
    def mesh_radius_m(self) -> float:
        """Return the radius of the mesh."""
        return self.radius_m + self.mesh_beyond_m

    @property
    def defect_radius_m(self) -> float:
        """Return the radius of the defect, 0 if there is none."""
        return max(0.0, self.radius_m - self.defect_within_m)


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
        check_range("grasp behind the tip", self.behind_tip_rad, 0.0, math.radians(300), "rad")
        for name in ("approach_rad", "lean_rad", "skew_rad"):
            check_range(f"grasp {name.removesuffix('_rad')}", getattr(self, name), -TURN, TURN, "rad")

    @property
    def rotation(self) -> SO3:
        """Return the orientation of the arm's tip in the frame of the grasped point."""
        aligned = SO3(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]))
        turned = SO3.axis("x", self.approach_rad) @ aligned @ SO3.axis("x", self.lean_rad)
        return turned @ SO3.axis("z", self.skew_rad)

    def pose(self, needle_radius_m: float) -> SE3:
        """Return the pose of the arm's tip in the frame of a needle of this radius."""
        at_point = SO3.axis("z", -self.behind_tip_rad)
        return SE3.from_parts(at_point @ self.rotation, at_point.apply([0.0, -needle_radius_m, 0.0]))

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
        theta_is: which point of the suture lies at theta: the ``middle`` of the bite, so that sutures are even where
            they hold, or its ``entry`` (open in the paper).
    """

    entry_angle_rad: float = math.radians(30.0)
    straight_m: float = 0.010
    rotation_rad: float = math.radians(70.0)
    regrasp_rad: float = math.radians(35.0)
    pushes: int = 2
    theta_is: str = "middle"

    def __post_init__(self) -> None:
        check_range("entry angle", self.entry_angle_rad, 0.0, math.pi / 2, "rad")
        check_range("straight path", self.straight_m, 0.0, 0.05)
        check_range("rotation", self.rotation_rad, 0.0, math.pi, "rad")
        check_range("regrasp angle", self.regrasp_rad, 0.0, math.pi, "rad")
        if self.pushes not in range(11):
            raise InvalidValue("the number of pushes", self.pushes, "give 0 to 10")
        if self.theta_is not in ("entry", "middle"):
            raise UnknownName("the point of a suture at theta", self.theta_is, ("entry", "middle"))

    @property
    def turn_rad(self) -> float:
        """Return the total rotation of the needle about its centre."""
        return self.rotation_rad + self.pushes * self.regrasp_rad


@dataclass(frozen=True)
class Wall:
    """The body wall, between two parallel planes in the world. Ports lie in it, instruments work below it.

    Attributes:
        up_m: height of its inner surface above the world's origin; 0: there is no wall.
        thick_m: distance of its outer surface from the inner one.
        slope_rad: its slope, where it is steepest.
        azimuth_rad: direction in which it rises, counterclockwise from x.
    """

    up_m: float = 0.0
    thick_m: float = 0.030
    slope_rad: float = 0.0
    azimuth_rad: float = 0.0

    def __post_init__(self) -> None:
        check_range("height of the body wall", self.up_m, 0.0, 0.5)
        check_range("thickness of the body wall", self.thick_m, 0.0, 0.1)
        check_range("slope of the body wall", self.slope_rad, 0.0, math.radians(60.0), "rad")
        check_range("azimuth of the body wall", self.azimuth_rad, -TURN, TURN, "rad")

    @property
    def normal(self) -> NDArray[np.float64]:
        """Return the outward normal (3,) in the world."""
        return (SO3.axis("z", self.azimuth_rad) @ SO3.axis("y", -self.slope_rad)).matrix[:, 2]

    def over_inside_m(self, point_m: ArrayLike) -> float:
        """Return how far a point (3,) in the world is outward of the inner surface; below 0 it is in the body."""
        return float(self.normal @ (np.asarray(point_m) - [0.0, 0.0, self.up_m]))

    def port_off_m(self, port_m: ArrayLike) -> float:
        """Return how far a port (3,) in the world lies outward of the wall, below 0 inward of it; 0 in the wall."""
        over_m = self.over_inside_m(port_m)
        return over_m - min(max(over_m, 0.0), self.thick_m) if self.up_m else 0.0


@dataclass(frozen=True)
class Puller:
    """The port of the second arm, which grasps the needle as it comes out and pulls it through.

    Until then its instrument is drawn back; then it goes straight from the port to the needle's tip. This model needs
    no joints. Direction and distance are by default those in the station ``suture-pair``.

    Attributes:
        azimuth_rad: direction of the port, counterclockwise from x.
        sideways_m: horizontal distance from the world's origin.
        up_m: height; 0: there is no second arm.
    """

    azimuth_rad: float = math.radians(125.0)
    sideways_m: float = 0.150
    up_m: float = 0.0

    def __post_init__(self) -> None:
        check_range("azimuth of the second port", self.azimuth_rad, -TURN, TURN, "rad")
        check_range("second port sideways", self.sideways_m, 0.0, 0.5)
        check_range("second port up", self.up_m, 0.0, 0.5)

    @staticmethod
    def at(port_m: NDArray[np.float64]) -> Puller:
        """Return the second arm with this port (3,) in the world."""
        x, y, up = port_m.tolist()
        return Puller(math.atan2(y, x), math.hypot(x, y), up)

    @property
    def port_m(self) -> NDArray[np.float64]:
        """Return the port (3,) in the world."""
        x, y = math.cos(self.azimuth_rad), math.sin(self.azimuth_rad)
        return np.array([self.sideways_m * x, self.sideways_m * y, self.up_m])


@dataclass(frozen=True)
class SutureSetup:
    """The complete geometry of a suture task.

    Attributes:
        arm: the arm that sutures; its tip is the point where the jaws hold the needle.
        T_world_base: pose of its base (remote centre).
    """

    arm: ArmModel = PSM_CLASSIC
    T_world_base: SE3 = field(default_factory=lambda: base_beside(math.radians(225.0), 0.050, 0.100))
    circle: Circle = field(default_factory=Circle)
    needle: Needle = field(default_factory=Needle)
    grasp: NeedleGrasp = field(default_factory=NeedleGrasp)
    insertion: Insertion = field(default_factory=Insertion)
    wall: Wall = field(default_factory=Wall)
    puller: Puller = field(default_factory=Puller)

    def __post_init__(self) -> None:
        if 2 * self.needle.radius_m > self.circle.radius_m:
            raise InvalidInput(
                f"a needle of radius {shown(self.needle.radius_m, 'm')}",
                f"is too large for a circle of radius {shown(self.circle.radius_m, 'm')}: its diameter may be at most "
                "the circle's radius",
                f"give a needle radius up to {shown(self.circle.radius_m / 2, 'm')} or a larger circle",
            )
        last_rad = self.grasp.behind_tip_rad + self.insertion.pushes * self.insertion.regrasp_rad
        if last_rad > self.needle.arc_rad + 1e-9:
            raise InvalidInput(
                "the last grasp",
                f"lies {shown(last_rad, 'rad', '.0f')} behind the needle's tip, beyond its tail at "
                f"{shown(self.needle.arc_rad, 'rad', '.0f')}",
                "grasp nearer to the tip, regrasp less or take a longer needle",
            )
        if self.insertion.theta_is == "middle" and math.isnan(self.exit_turn_rad):
            straight, down = (
                shown(self.insertion.straight_m, "m", "g"),
                shown(self.insertion.entry_angle_rad, "rad", "g"),
            )
            raise InvalidInput(
                f"after {straight} straight at {down} a needle of radius {shown(self.needle.radius_m, 'm', 'g')}",
                "never comes out, so its suture has no middle",
                "let theta be the entry, shorten the straight path or lower the entry angle",
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

    @property
    def port_above_tissue_m(self) -> float:
        """Return the height of the arm's port above the tissue's plane."""
        return float(self.T_base_circle.inverse().translation_m[2])

    @property
    def exit_turn_rad(self) -> float:
        """Return the rotation of the needle at which its tip leaves the tissue's surface; NaN if it never would."""
        entry_rad, straight_m = self.insertion.entry_angle_rad, self.insertion.straight_m
        cosine = math.cos(entry_rad) - straight_m * math.sin(entry_rad) / self.needle.radius_m
        return entry_rad + math.acos(cosine) if cosine >= -1.0 else math.nan

    @property
    def comes_out(self) -> bool:
        """Return whether the needle is rotated far enough for its tip to come out of the tissue."""
        return self.insertion.turn_rad >= self.exit_turn_rad - 1e-9

    @property
    def bite_m(self) -> float:
        """Return the distance along the surface from entry to exit; NaN if the tip never comes out."""
        down = self.insertion.entry_angle_rad
        arc_m = self.needle.radius_m * (math.sin(self.exit_turn_rad - down) + math.sin(down))
        return self.insertion.straight_m * math.cos(down) + arc_m


def base_beside(
    azimuth_rad: float, sideways_m: float, up_m: float, tilt_rad: float = 0.0, spin_rad: float = 0.0
) -> SE3:
    """Return the pose of a base beside and above the world's origin, with rotation ``Rz(azimuth) Ry(tilt) Rz(spin)``.

    The azimuth is counterclockwise from x; the tilt leans the instrument (at rest along -z of the base) towards the
    origin.
    """
    for name, value in (("sideways", sideways_m), ("up", up_m)):
        check_range(f"base {name}", value, -0.5, 0.5)
    for name, value in (("azimuth", azimuth_rad), ("tilt", tilt_rad), ("spin", spin_rad)):
        if not math.isfinite(value):
            raise InvalidValue(f"the base {name}", shown(value, "rad", "g"), "give a finite angle")
    place_m = [sideways_m * math.cos(azimuth_rad), sideways_m * math.sin(azimuth_rad), up_m]
    return SE3.from_parts(SO3.axis("z", azimuth_rad) @ SO3.axis("y", tilt_rad) @ SO3.axis("z", spin_rad), place_m)


def mirrored(setup: SutureSetup) -> SutureSetup:
    """Return the mirror image of a setup's base and grasp in the y-z plane of its circle: the second arm (assumed).

    The body wall stays as it is, and there is no second port.

    An arm that is symmetric about the plane of its yaw axis, as the PSM is, then moves at pi - theta, in the other
    direction, as it did at theta. The paper does not say where its second arm stands or how it holds the needle.
    """
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    T_circle_base = setup.T_base_circle.inverse().matrix
    grasp = replace(setup.grasp, approach_rad=-setup.grasp.approach_rad, skew_rad=-setup.grasp.skew_rad)
    base = setup.circle.T_world_circle @ SE3.unchecked(flip @ T_circle_base @ flip)
    return replace(setup, T_world_base=base, grasp=grasp, puller=Puller())
