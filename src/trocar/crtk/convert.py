"""Transforms, velocities and matrices as messages, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.crtk.messages import (
    Float64MultiArray,
    MultiArrayDimension,
    MultiArrayLayout,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Time,
    TransformStamped,
    Twist,
    Vector3,
)
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3


def pose_of(T: SE3) -> Pose:
    """Return a transform as a message, the scalar of its quaternion last."""
    w, x, y, z = T.rotation.as_quaternion().tolist()
    return Pose(Point(*T.translation_m.tolist()), Quaternion(x, y, z, w))


def transform_of(pose: Pose) -> SE3:
    """Return the transform of a message."""
    q = pose.orientation
    place = pose.position
    return SE3.from_parts(SO3.from_quaternion([q.w, q.x, q.y, q.z]), [place.x, place.y, place.z])


def twist_of(linear: NDArray[np.float64], angular: NDArray[np.float64]) -> Twist:
    """Return velocities (3,), m/s and rad/s, as a message."""
    return Twist(Vector3(*linear.tolist()), Vector3(*angular.tolist()))


def matrix_of(matrix: NDArray[np.float64]) -> Float64MultiArray:
    """Return a matrix (rows, columns) as a message, row by row."""
    rows, columns = matrix.shape
    layout = [MultiArrayDimension("rows", rows, rows * columns), MultiArrayDimension("columns", columns, columns)]
    return Float64MultiArray(MultiArrayLayout(layout), matrix.ravel().tolist())


def seconds(stamp: Time) -> float:
    """Return a stamp in s since 1970; 0: the data are not valid."""
    return stamp.sec + 1e-9 * stamp.nanosec


def place_of(message: PoseStamped | TransformStamped) -> SE3 | None:
    """Return the transform of a message of either generation; None if it is not valid, such as one with NaN."""
    if isinstance(message, TransformStamped):
        place = message.transform.translation
        pose = Pose(Point(place.x, place.y, place.z), message.transform.rotation)
    else:
        pose = message.pose
    try:
        return transform_of(pose)
    except TrocarError:
        return None
