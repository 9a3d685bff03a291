"""The solids of an arm's instrument: as capsules for planning, and link by link for simulator and exported models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms.forward import frames
from trocar.arms.instrument import CLEVIS_SHARE, KNUCKLE_SHARE, SLEEVE_M, SLEEVE_SHARE
from trocar.arms.model import ArmModel
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import Capsules, cross

SOLIDS = ("shaft", "wrist", "left finger", "right finger")  # what the capsules of :func:`capsules` stand for, in order
MOVED = np.array([[1, 1, 1, 0, 0, 0], [1, 1, 1, 1, 1, 0], [1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 1, 1]], dtype=np.float64)
"""(4, 6) 1 where a joint moves the axis of a capsule of :func:`capsules`, else 0."""

_ENDS = np.array([[0, 1], [2, 3], [3, 4], [3, 5]])
"""Ends of shaft, wrist and fingers among the points of :func:`_points`; both fingers start at the wrist's end."""


def capsules(arm: ArmModel, q: ArrayLike, jaw_rad: ArrayLike = 0.0) -> Capsules:
    """Return shaft, wrist and both fingers (:data:`SOLIDS`) as capsules in the arm's base: ends (..., 4, 2, 3) m.

    Each capsule contains the whole solid that it stands for.

    Args:
        arm: whose instrument.
        q: (..., 6) joints, rad and m.
        jaw_rad: (...,) opening between the fingers.
    """
    points = _points(arm, arm.configurations(q), np.asarray(jaw_rad, dtype=np.float64))
    return Capsules(points[..., _ENDS, :], solid_radii_m(arm))


def solid_radii_m(arm: ArmModel) -> Array:
    """Return the radii (4,) of :func:`capsules`, which no configuration changes."""
    shape = arm.instrument
    return np.array([shape.shaft_radius_m, shape.wrist_radius_m, shape.finger_radius_m, shape.finger_radius_m])


def joint_axes(arm: ArmModel, q: ArrayLike) -> tuple[Array, Array]:
    """Return the axes of the joints, and points on them, in the arm's base: (..., 6, 3) each, m.

    The axis of the sliding joint is its direction of motion. Points of the instrument move by ``axis x (point -
    origin)`` for each joint that turns; :data:`MOVED` tells which parts a joint moves.

    ``arm``: whose joints; ``q``: (..., 6) joints, rad and m.
    """
    q = arm.configurations(q)
    depth, shaft, out, side = _wrist(arm, q)
    (c0, s0), (c1, s1), _ = arm.twist_cosines
    yaw = q[..., 0] + arm.offsets[0]
    x, y = np.sin(yaw) * s1, -np.cos(yaw) * s1
    axes, origins = np.empty((*q.shape, 3)), np.zeros((*q.shape, 3))
    axes[..., 0, :] = 0.0, -s0, c0
    axes[..., 1, 0], axes[..., 1, 1], axes[..., 1, 2] = x, c0 * y - s0 * c1, s0 * y + c0 * c1
    axes[..., 2, :] = axes[..., 3, :] = shaft
    axes[..., 4, :] = -arm.wrist_sign * side
    axes[..., 5, :] = cross(side, out)
    origins[..., 4, :] = depth[..., None] * shaft
    origins[..., 5, :] = origins[..., 4, :] + arm.wrist_length_m * out
    return axes, origins


def _points(arm: ArmModel, q: Array, jaw_rad: Array) -> Array:
    """Return the shaft's lower and upper end, pitch axis, yaw axis, ends of the fingers: (..., 6, 3) m in the base.

    Written out, since a guard asks for hundreds of configurations before every motion; the frames of
    :func:`trocar.arms.frames` give the same points ten times slower (``tests/arms/test_solids.py``).
    """
    shape = arm.instrument
    depth, shaft, out, side = _wrist(arm, q)
    up = arm.wrist_sign * shaft
    pitch = depth[..., None] * shaft
    yaw = pitch + arm.wrist_length_m * out
    # the shaft is a cylinder that ends flat at the wrist: the round cap of its capsule starts one radius further up
    points = [pitch + shape.shaft_radius_m * up, pitch + shape.shaft_length_m * up, pitch, yaw]
    for angle in (0.5 * jaw_rad, -0.5 * jaw_rad):  # the jaws point along y of frame 6 and turn about its z
        turned = q[..., 5] + arm.offsets[5] + angle
        finger = np.cos(turned)[..., None] * out - np.sin(turned)[..., None] * side
        points.append(yaw + shape.finger_length_m * finger)
    return np.stack(points, -2)


def _wrist(arm: ArmModel, q: Array) -> tuple[Array, ...]:
    """Return the depth of frame 4 along its z axis (...,); in the base (..., 3): that axis, the wrist link, y of 4."""
    (c0, s0), (c1, s1), (c2, s2) = arm.twist_cosines
    turned = np.moveaxis(q + np.array(arm.offsets), -1, 0)
    (k1, k2, _, k4, k5, _), (n1, n2, _, n4, n5, _) = np.cos(turned), np.sin(turned)

    def base(x: Any, y: Any, z: Any) -> Array:  # Rx(twist 0) Rz(q1) Rx(twist 1)
        y, z = c1 * y - s1 * z, s1 * y + c1 * z
        x, y = k1 * x - n1 * y, n1 * x + k1 * y
        return np.stack([x, c0 * y - s0 * z, s0 * y + c0 * z], -1)

    x3, y3, shaft = base(k2, n2, 0.0), base(-c2 * n2, c2 * k2, s2), base(s2 * n2, -s2 * k2, c2)
    x4 = k4[..., None] * x3 + n4[..., None] * y3
    y4 = k4[..., None] * y3 - n4[..., None] * x3
    out = n5[..., None] * x4 - arm.wrist_sign * k5[..., None] * shaft
    return turned[2], shaft, out, y4


STEEL = (0.62, 0.63, 0.66)
CARBON = (0.10, 0.11, 0.13)
HOUSING = (0.55, 0.56, 0.60)
DRIVE_M = (0.06, 0.09, 0.08)  # size of the drive unit behind the shaft (assumed)


@dataclass(frozen=True, eq=False)
class Part:
    """One solid, in the frame of the link that carries it."""

    name: str  # what it is
    link: int  # number of that frame, 1 to 6 (modified DH)
    shape: Literal["cylinder", "capsule", "box"]  # a capsule's caps go beyond its ends
    # (2, 3) ends of the axis of a cylinder or capsule; (1, 3) middle of a box, whose sides are along x, y, z
    at_m: Array
    size_m: tuple[float, ...]  # radius of a cylinder or capsule; three sides of a box
    rgb: tuple[float, float, float]  # colour, each in [0, 1]


def parts_of(arm: ArmModel) -> tuple[Part, ...]:
    """Return all solids of an arm's instrument except its fingers (``Instrument.finger_m``), which the jaws move.

    The shaft is attached to the roll link, whose origin is on the pitch axis and whose z runs along the shaft.
    """
    shape, back = arm.instrument, float(arm.wrist_sign)  # from the wrist towards the remote centre
    at_zero = frames(arm, np.zeros(6))
    wrist_m = (at_zero[5].inverse() @ at_zero[6]).translation_m
    length, half = shape.shaft_length_m, 0.5 * KNUCKLE_SHARE * shape.finger_width_m
    sleeve, shaft = (shape.shaft_radius_m * SLEEVE_SHARE,), (shape.shaft_radius_m,)
    return (
        Part("sleeve", 4, "cylinder", _along_z(*(back * z for z in SLEEVE_M)), sleeve, STEEL),
        Part("shaft", 4, "cylinder", _along_z(back * (SLEEVE_M[1] + 1e-3), back * length), shaft, CARBON),
        Part("drive", 4, "box", _along_z(back * (length + 0.5 * DRIVE_M[2])), DRIVE_M, HOUSING),
        Part("wrist", 5, "capsule", np.array([np.zeros(3), CLEVIS_SHARE * wrist_m]), (shape.wrist_radius_m,), STEEL),
        Part("knuckle", 6, "cylinder", _along_z(half, -half), (shape.knuckle_radius_m,), STEEL),
    )


def _along_z(*z: float) -> Array:
    return np.array([[0.0, 0.0, value] for value in z])
