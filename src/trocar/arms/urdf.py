"""A type of arm as URDF, for ROS and for simulators that read it."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms.forward import frames
from trocar.arms.model import ArmModel, Joint
from trocar.arms.psm import PSM_CLASSIC
from trocar.arms.solids import CARBON, HOUSING, STEEL, Part, parts_of
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array

DVRK = {joint.name: f"outer_{joint.name}" for joint in PSM_CLASSIC.joints}
"""Names of the PSM's joints in the dVRK's own models."""
BASE, TIP = "base_link", "tool_tip_link"
TENSOR = ("xx", "xy", "xz", "yy", "yz", "zz")
MATERIALS = {STEEL: "steel", CARBON: "carbon", HOUSING: "housing"}
EFFORT = 100.0  # N m or N; no source gives the limits, but URDF requires them
NOTHING = 1e-15  # smaller values are written as 0
LINK_KG, LINK_KG_M2 = 0.1, 1e-4
"""Mass and inertia of every moving link, at its origin (assumed: no source gives them, but simulators need some)."""


def joint_names(arm: ArmModel) -> tuple[str, ...]:
    """Return the names of the six joints in URDF: a PSM's as in the dVRK's models, others as in ``arm``."""
    names = tuple(joint.name for joint in arm.joints)
    return tuple(DVRK[name] for name in names) if names == tuple(DVRK) else names


def arm_urdf(arm: ArmModel) -> str:
    """Return an arm as self-contained URDF text: no meshes, no other files.

    The chain is serial and goes through the remote centre; a real arm's parallelogram and external drives are left
    out. ``base_link`` is the remote centre, frame 0 of :func:`trocar.arms.frames`. Each joint ``NAME`` moves the link
    ``NAME_link``, whose frame is the joint's, z along its axis. ``jaw`` is the opening of the jaws, which each finger
    mimics by half; ``tool_tip_link`` is the controlled point.
    """
    robot = Element("robot", name=arm.name.replace("-", "_"))
    for rgb, name in MATERIALS.items():
        SubElement(SubElement(robot, "material", name=name), "color", rgba=_text((*rgb, 1)))
    _add_link(robot, BASE)
    at_zero, parent = frames(arm, np.zeros(6)), BASE
    for index, (joint, name) in enumerate(zip(arm.joints, joint_names(arm), strict=True)):
        parts = [part for part in parts_of(arm) if part.link == index + 1]
        _add_link(robot, f"{name}_link", parts, moves=True)
        _add_joint(robot, name, joint, parent, at_zero[index].inverse() @ at_zero[index + 1])
        parent = f"{name}_link"
    _add_link(robot, TIP)
    fixed = SubElement(robot, "joint", name="tool_tip", type="fixed")
    _connect(fixed, parent, TIP, at_zero[6].inverse() @ at_zero[7])
    _add_jaws(robot, arm, parent)
    indent(robot)
    return tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _add_jaws(robot: Element, arm: ArmModel, parent: str) -> None:
    """Add the opening of the jaws as a joint, and the fingers that mimic it, each a box of its mean thickness."""
    shape, along_y = arm.instrument, SE3.from_parts(SO3.axis("z", np.pi / 2))  # a finger's x is y of frame 6
    _add_link(robot, "jaw_link", moves=True)
    _add_joint(robot, "jaw", arm.jaw, parent, along_y)
    thick = 0.5 * (shape.finger_base_m + shape.finger_tip_m)
    for name, side in (("jaw_left", 1), ("jaw_right", -1)):
        middle = np.array([[0.5 * shape.finger_length_m, 0.5 * side * thick, 0.0]])
        finger = Part(name, 6, "box", middle, (shape.finger_length_m, thick, shape.finger_width_m), STEEL)
        _add_link(robot, f"{name}_link", (finger,), moves=True)
        lower, upper = sorted((0.5 * side * arm.jaw.lower, 0.5 * side * arm.jaw.upper))
        half = Joint(name, lower, upper, 0.5 * arm.jaw.max_speed, 0.5 * arm.jaw.max_acceleration)
        joint = _add_joint(robot, name, half, parent, along_y)
        SubElement(joint, "mimic", joint="jaw", multiplier=_text(0.5 * side), offset="0")


def _add_link(robot: Element, name: str, parts: Iterable[Part] = (), *, moves: bool = False) -> None:
    """Add a link with its solids, visual and collision shapes alike; one that moves gets a mass."""
    link = SubElement(robot, "link", name=name)
    if moves:
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", value=_text(LINK_KG))
        SubElement(inertial, "inertia", {f"i{xy}": _text(LINK_KG_M2 * (xy[0] == xy[1])) for xy in TENSOR})
    for part in parts:
        for number, (tag, sizes, T) in enumerate(_primitives(part)):
            for use in ("visual", "collision"):
                solid = SubElement(link, use, name=f"{part.name}_{number}_{use}")
                _add_origin(solid, T)
                SubElement(SubElement(solid, "geometry"), tag, sizes)
                if use == "visual":
                    SubElement(solid, "material", name=MATERIALS[part.rgb])


def _primitives(part: Part) -> list[tuple[str, dict[str, str], SE3]]:
    """Return a solid as URDF shapes: tag, sizes, pose in the link. URDF has no capsules: a cylinder and two spheres."""
    if part.shape == "box":
        return [("box", {"size": _text(part.size_m)}, SE3.from_parts(translation_m=part.at_m[0]))]
    start, end = part.at_m
    length, radius = np.linalg.norm(end - start), {"radius": _text(part.size_m[0])}
    along = SE3.from_parts(SO3.between(np.array([0.0, 0.0, 1.0]), (end - start) / length), 0.5 * (start + end))
    found = [("cylinder", {**radius, "length": _text(length)}, along)]
    if part.shape == "capsule":
        found += [("sphere", radius, SE3.from_parts(translation_m=at)) for at in (start, end)]
    return found


def _add_joint(robot: Element, name: str, joint: Joint, parent: str, T_parent_joint: SE3) -> Element:
    """Add a joint about, or along, z of its own frame."""
    added = SubElement(robot, "joint", name=name, type="prismatic" if joint.prismatic else "revolute")
    _connect(added, parent, f"{name}_link", T_parent_joint)
    SubElement(added, "axis", xyz="0 0 1")
    limits = {"lower": joint.lower, "upper": joint.upper, "velocity": joint.max_speed, "effort": EFFORT}
    SubElement(added, "limit", {key: _text(value) for key, value in limits.items()})
    return added


def _connect(joint: Element, parent: str, child: str, T_parent_child: SE3) -> None:
    _add_origin(joint, T_parent_child)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _add_origin(element: Element, T: SE3) -> None:
    SubElement(element, "origin", xyz=_text(T.translation_m), rpy=_text(roll_pitch_yaw(T.rotation)))


def roll_pitch_yaw(rotation: SO3) -> Array:
    """Return the angles (3,) with ``Rz(yaw) Ry(pitch) Rx(roll)`` = rotation; roll is 0 where pitch is 90 deg."""
    R = rotation.matrix
    level = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = np.arctan2(-R[2, 0], level)
    if level < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-R[0, 1], R[1, 1])])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _text(values: ArrayLike) -> str:
    """Return numbers as an attribute, to twelve digits."""
    flat = np.atleast_1d(np.asarray(values, dtype=np.float64)).ravel()
    return " ".join(f"{value:.12g}" for value in np.where(np.abs(flat) < NOTHING, 0.0, flat))
