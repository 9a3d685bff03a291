"""A needle in made-up depth images: a wire over a coloured floor, under a camera with depth noise."""

import numpy as np

from trocar.geometry import SE3, SO3
from trocar.perception.depth import pixel_rays
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.tasks.suture.needle import Needle

ARC = Needle(8.3e-3, np.radians(225.0), 0.9e-3)
LENS = Intrinsics(140, 140, 1382.7, 1383.0, 69.5, 69.5)
HALF_LENS = LENS.binned(2)
"""A lens in whose images the wire is two pixels wide, as in the cell."""
T_CAMERA_FLOOR = SE3.from_parts(SO3.axis("x", np.pi - 0.5), [0.0, 0.0, 0.36])
FLOOR_RGB, STEEL_RGB = (220, 163, 140), (190, 195, 204)
REACH_M = ARC.radius_m + ARC.wire_m
"""No point of the wire is farther from its centre."""


def over_floor(rng):
    """Return the random pose of a needle over the floor, in the camera's frame."""
    turn = SO3.axis("z", rng.uniform(-1.0, 1.0)) @ SO3.axis("x", np.pi / 2) @ SO3.axis("z", rng.uniform(-0.5, 0.5))
    return T_CAMERA_FLOOR @ SE3.from_parts(turn, [0.0, 0.0, 0.014])


def first_met(T_camera_needle, rays):
    """Return the depths (n,) at which rays (n, 3) first meet the wire, and which (n,) of them meet it."""
    centre, length = T_camera_needle.translation_m, np.linalg.norm(rays, axis=1)
    depth, met = np.full(len(rays), centre[2] - 2.0 * REACH_M), np.zeros(len(rays), dtype=bool)
    T_needle = T_camera_needle.inverse()
    on = np.flatnonzero(np.linalg.norm(np.cross(rays, centre), axis=1) / length < REACH_M)
    for _ in range(200):  # sphere tracing: advance by the distance to the wire
        ahead = ARC.distance_m(T_needle.apply(rays[on] * depth[on, None]))
        met[on] = ahead < 1e-6
        depth[on] += ahead / length[on]
        on = on[(ahead >= 1e-6) & (depth[on] < centre[2] + REACH_M)]
        if not len(on):
            break
    return depth, met


def picture(T_camera_needle, rng, depth_sd_m=0.15e-3, lens=LENS):
    """Return an image: each ray ends on the wire, if it meets it, or on the floor."""
    rays = pixel_rays(lens).reshape(-1, 3)
    T_floor = T_CAMERA_FLOOR.inverse()
    on_wire, met = first_met(T_camera_needle, rays)
    depth = np.where(met, on_wire, -T_floor.translation_m[2] / (rays @ T_floor.rotation.matrix[2]))
    color = np.where(met[:, None], STEEL_RGB, FLOOR_RGB).astype(np.uint8)
    depth = depth + depth_sd_m * rng.standard_normal(len(depth))
    shape = (lens.height, lens.width)
    return RgbdImage(color.reshape(*shape, 3), depth.reshape(shape).astype(np.float32), lens)
