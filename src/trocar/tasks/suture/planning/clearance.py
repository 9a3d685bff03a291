"""How far an instrument that drives a needle stays from the tissue, the body wall and a second instrument."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, wrist_depth_m
from trocar.arms.solids import DRIVE_M
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import segment_distances_m
from trocar.tasks.suture.planning.setup import SutureSetup

JAW_OPEN_RAD = 0.40
"""An opening that clears the wire."""
FINGER, CLOSING = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])
"""In the frame of an arm's tip: along the jaws, and out of the plane in which they meet."""
UP = np.array([[0.0, 0.0, 1.0]])
OFF_WALL_M = 5.0e-3
"""Least distance of instrument and needle from the body wall (assumed)."""
APART_M = 4.0e-3
"""Least distance of the two instruments, the same that ``trocar.robots.Coordinator`` keeps by default."""


def fingers_above_m(arm: ArmModel, T_circle_tip: SE3, opened: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the height (2, k) of the fingers' lowest corner above the tissue's plane.

    Args:
        arm: the arm that carries the instrument.
        T_circle_tip: (2, k) poses of its tip at theta = 0; other positions only turn them about the vertical.
        opened: (k,) whether the jaws are open there at some time.
    """
    closed, wide = (_lowest_m(arm, T_circle_tip, jaw) for jaw in (0.0, JAW_OPEN_RAD))
    return np.where(opened, np.minimum(closed, wide), closed)


def _lowest_m(arm: ArmModel, T_circle_tip: SE3, jaw_rad: float) -> NDArray[np.float64]:
    """Return the height (2, k) of the lowest corner of fingers with this opening."""
    x, y, z = np.concatenate(
        [arm.instrument.finger_m(side) @ SO3.axis("z", side * jaw_rad / 2).matrix.T for side in (1, -1)]
    ).T
    in_tip = np.stack([y, z, arm.tip_length_m - x])
    return T_circle_tip.matrix[..., 2, 3] + (T_circle_tip.matrix[..., 2, :3] @ in_tip).min(-1)


def above_tissue_m(
    arm: ArmModel, T_circle_tip: SE3, opened: NDArray[np.bool_], wrist_yaw_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the least height (2, n) of the instrument above the tissue's plane along sutures; NaN counts as high.

    The wrist and the lower end of the shaft are modelled as a ball at the wrist's pitch axis, the boss of the jaws as a
    ball at their axis. Further up, the shaft rises to the port.

    Args:
        arm: as for ``fingers_above_m``.
        T_circle_tip: likewise.
        opened: likewise.
        wrist_yaw_rad: (2, n, k) the arm's last joint.
    """
    shape = arm.instrument
    yaw_axis, pitch_axis, _ = _heights_m(arm, T_circle_tip, UP, wrist_yaw_rad)
    wrist = np.fmin.reduce(pitch_axis, axis=-1) - max(shape.shaft_radius_m, shape.wrist_radius_m)
    jaws = np.minimum(fingers_above_m(arm, T_circle_tip, opened), yaw_axis[:, 0] - shape.knuckle_radius_m).min(-1)
    return np.fmin(jaws[:, None], wrist)


def _heights_m(
    arm: ArmModel, T_circle_tip: SE3, normals: NDArray[np.float64], wrist_yaw_rad: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the heights (2, n, k) of yaw axis, pitch axis and fingertips along normals (n, 3)."""
    matrix = T_circle_tip.matrix
    along, aside, tip = (
        normals @ part.swapaxes(-1, -2)
        for part in (matrix[..., :3, :3] @ FINGER, matrix[..., :3, :3] @ CLOSING, matrix[..., :3, 3])
    )
    turned = wrist_yaw_rad + arm.offsets[5]
    yaw_axis = tip - arm.tip_length_m * along
    pitch_axis = yaw_axis - arm.wrist_length_m * (np.cos(turned) * along + np.sin(turned) * aside)
    return yaw_axis, pitch_axis, yaw_axis + arm.instrument.finger_length_m * along


def inside_wall_m(
    setup: SutureSetup,
    thetas_rad: NDArray[np.float64],
    T_circle_tip: SE3,
    T_circle_needle: SE3,
    q: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the clearance (2, n) of sutures from the body wall, less the required ``OFF_WALL_M``.

    Ports have to lie in the wall. Wrist, jaws and needle, whose arc counts as a whole circle, have to stay inside of
    it, and the drive unit at the shaft's other end outside. In between, the shaft passes through the port.

    Args:
        setup: the geometry.
        thetas_rad: (n,) positions.
        T_circle_tip: (2, k) poses of the arm's tip at theta = 0.
        T_circle_needle: (2, k) poses of the needle at theta = 0.
        q: (2, n, k, 6) joints; NaN counts as far away.
    """
    wall, arm, shape = setup.wall, setup.arm, setup.arm.instrument
    port_m = setup.T_world_base.translation_m
    off_m = max(abs(wall.port_off_m(port)) for port in (port_m, *([setup.puller.port_m] if setup.puller.up_m else ())))
    T = setup.circle.T_world_circle
    normals = (SO3.axis("z", thetas_rad).matrix.swapaxes(-1, -2) @ T.rotation.matrix.T) @ wall.normal
    yaw_axis, pitch_axis, fingers = _heights_m(arm, T_circle_tip, normals, q[..., 5])
    needle = T_circle_needle.matrix
    centre, across = (normals @ needle[..., :3, part].swapaxes(-1, -2) for part in (3, 2))
    reach_m = setup.needle.radius_m + setup.needle.wire_m / 2
    highest = np.maximum(
        yaw_axis + shape.knuckle_radius_m,
        fingers + shape.finger_radius_m + shape.finger_length_m * np.sin(JAW_OPEN_RAD / 2),
    )
    highest = np.maximum(highest, centre + reach_m * np.sqrt(np.maximum(1.0 - across**2, 0.0)))
    highest = np.fmax(highest, pitch_axis + max(shape.shaft_radius_m, shape.wrist_radius_m))
    centre_m = wall.over_inside_m(T.translation_m)
    port_over_m = wall.over_inside_m(port_m)
    # the shaft goes on straight from the wrist through the port to the drive unit
    depth_m = np.maximum(wrist_depth_m(arm, q), 1e-3)
    rises = (port_over_m - centre_m - pitch_axis) / depth_m
    outside = port_over_m - wall.thick_m + rises * (shape.shaft_length_m - depth_m) - np.hypot(*DRIVE_M[:2]) / 2
    clear = np.fmin(-centre_m - highest, outside)
    return np.minimum(np.fmin.reduce(clear, axis=-1) - OFF_WALL_M, -off_m if off_m else np.inf)


def arms_apart_m(
    setup: SutureSetup,
    thetas_rad: NDArray[np.float64],
    needle_tip_m: NDArray[np.float64],
    q_end: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the clearance (2, n) between the two instruments, less the required ``APART_M``.

    It counts where the second instrument comes to grasp the needle: straight from its port to the needle's tip.

    Args:
        setup: the geometry.
        thetas_rad: (n,) positions.
        needle_tip_m: (2, 3) the needle's tip at the end of a suture, in the circle's frame at theta = 0.
        q_end: (2, n, 6) the first arm's joints then.
    """
    known = np.all(np.isfinite(q_end), axis=-1)
    solids = capsules(setup.arm, np.where(known[..., None], q_end, 0.0))
    port_m = setup.T_world_base.inverse().apply(setup.puller.port_m)
    tips = needle_tip_m @ SO3.axis("z", thetas_rad).matrix.swapaxes(-1, -2)  # (n, 2, 3)
    tips = setup.T_base_circle.apply(tips).swapaxes(0, 1)[..., None, :]
    apart = segment_distances_m(port_m, tips, solids.ends_m[..., 0, :], solids.ends_m[..., 1, :]) - solids.radii_m
    return np.where(known, apart.min(-1) - setup.arm.instrument.shaft_radius_m - APART_M, np.inf)
