"""Turn exact ray casts into the image of a structured-light camera: colour under its projector, and flaws."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry.arrays import Array
from trocar.lab.station import SensorFlaws


@dataclass(frozen=True)
class Light:
    """The light of the projector and of the room.

    The defaults give plate, table and shadow the RGB levels of `images/handover`: 205 60 14, 23 23 17, 52 11 1.

    Attributes:
        ambient: light from all directions, as a share of the projector's at ``reference_m``.
        gain: exposure gain.
        reference_m: distance from the projector at which its light has power 1.
    """

    ambient: float = 0.06
    gain: float = 1.2
    reference_m: float = 0.6


METAL_SATURATION = 0.35
METAL_BRIGHTNESS = 0.4
MIRROR_EXPONENT = 80.0
EDGE_M = 1.5e-3
"""Second difference of depth above which a pixel is at an edge; smooth surfaces stay below it up to 75 deg."""
MUJOCO_GREY = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour of a geom; a geom with it gets the colour of its material."""
LENS_BLUR_PX = 0.6
"""SD of the lens's point spread function (assumed)."""


def shade(
    model: mujoco.MjModel,
    rays: Array,
    depth_m: Array,
    geom: NDArray[np.int32],
    normal: Array,
    lit: NDArray[np.bool_],
    projector_m: ArrayLike,
    light: Light,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return colour (n, 3) in [0, 1] by Lambert's law under the projector, and the metal's specular part of it (n,).

    Args:
        model: MuJoCo's model, for the colours of geoms and materials.
        rays: (n, 3) rays in the camera frame, z = 1.
        depth_m: (n,) depth, NaN where nothing was hit.
        geom: (n,) ids of geoms, -1 for nothing.
        normal: (n, 3) outward normals in the camera frame.
        lit: (n,) whether the projector reaches the point.
        projector_m: (3,) position of the projector in the camera frame.
        light: the light.
    """
    albedo = model.geom_rgba[:, :3].astype(np.float32)
    with_material = (model.geom_matid >= 0) & (model.geom_rgba == MUJOCO_GREY).all(-1)
    albedo[with_material] = model.mat_rgba[model.geom_matid[with_material], :3]
    brightest = albedo.max(-1)
    saturation = (brightest - albedo.min(-1)) / np.maximum(brightest, 1e-6)
    metal = np.append((saturation < METAL_SATURATION) & (brightest > METAL_BRIGHTNESS), False)
    albedo = np.concatenate([albedo, np.zeros((1, 3), np.float32)])

    to_light = (np.asarray(projector_m) - rays * depth_m[:, None]).astype(np.float32)
    distance = np.sqrt(np.einsum("ij,ij->i", to_light, to_light))
    to_light /= distance[:, None]
    facing = normal.astype(np.float32)
    cosine = np.maximum(np.einsum("ij,ij->i", facing, to_light), 0)
    power = cosine * (np.float32(light.reference_m) / distance) ** 2
    power = power * lit
    color = albedo[geom] * np.float32(light.gain) * (np.float32(light.ambient) + power)[:, None]
    mirror = np.zeros(len(geom), np.float32)
    shiny = np.flatnonzero(metal[geom] & (power > 0))
    if len(shiny):
        to_eye = -rays[shiny] / np.linalg.norm(rays[shiny], axis=-1, keepdims=True)
        half = to_light[shiny] + to_eye
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        mirror[shiny] = np.maximum(np.einsum("ij,ij->i", facing[shiny], half), 0) ** MIRROR_EXPONENT
    color = np.clip(color + mirror[:, None], 0, 1)
    return np.nan_to_num(color), mirror


def apply_flaws(
    flaws: SensorFlaws,
    depth_m: Array,
    color: NDArray[np.float32],
    cosine: NDArray[np.float32],
    lit: NDArray[np.bool_],
    mirror: NDArray[np.float32],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return depth (h, w) float32 and colour (h, w, 3) uint8 as the sensor delivers them.

    The number of random values does not depend on the scene, so a seed gives the same sensor noise in every scene.
    """
    shape = depth_m.shape
    white = rng.standard_normal(shape, dtype=np.float32)
    wave = _smooth_noise(shape, flaws.waviness_px, rng)
    lost = rng.random(shape, dtype=np.float32)
    edge_luck = rng.random(shape, dtype=np.float32)
    mix = rng.random(shape, dtype=np.float32)
    grain = rng.standard_normal((*shape, 1), dtype=np.float32)

    exact = depth_m.astype(np.float32)
    scale = (exact / np.float32(flaws.reference_m)) ** 2 / np.maximum(cosine, np.float32(0.15))
    depth = exact + scale * (np.float32(flaws.axial_m) * white + np.float32(flaws.waviness_m) * wave)
    missing = lost < flaws.missing
    if flaws.grazing_cos > 0:
        missing |= cosine < flaws.grazing_cos * (0.5 + lost)
    if flaws.edge_missing > 0 or flaws.edge_mixed > 0:
        edge, other = _edges(exact)
        mixed = edge & (edge_luck < flaws.edge_mixed)
        depth[mixed] += (mix * (other - exact))[mixed]
        missing |= edge & (edge_luck > 1 - flaws.edge_missing)
    if flaws.shadow:
        missing |= ~lit
    missing |= mirror * flaws.specular_missing > lost + 0.1
    depth[missing] = np.nan
    noisy = color * 255 + np.float32(flaws.color_sd) * (0.3 + np.sqrt(color)) * grain
    return np.asarray(depth, np.float32), np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)


def expose(color: NDArray[np.float32], sd: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) of a colour camera: slightly blurred, with independent noise in each channel.

    Args:
        color: (h, w, 3) in [0, 1], or brighter where the camera saturates.
        sd: scale of the noise in grey levels; the noise grows with the root of the light.
        rng: random numbers for the noise.
    """
    blurred = cv2.GaussianBlur(color, (0, 0), LENS_BLUR_PX, borderType=cv2.BORDER_REPLICATE)
    grain = rng.standard_normal(color.shape, dtype=np.float32)
    noisy = blurred * 255 + np.float32(sd) * (0.3 + np.sqrt(blurred)) * grain
    return np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)


def _smooth_noise(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return noise of unit variance with a correlation length of about ``length`` pixels."""
    coarse = rng.standard_normal([int(n / length) + 2 for n in shape], dtype=np.float32)
    fine = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return (fine / max(float(fine.std()), 1e-6)).astype(np.float32)


def _edges(depth_m: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return which pixels lie beside a jump of depth, and the depth across it."""
    edge = np.zeros(depth_m.shape, dtype=bool)
    other = depth_m.copy()
    for axis in (0, 1):
        d = np.moveaxis(depth_m, axis, 0)
        before, here, after = d[:-2], d[1:-1], d[2:]
        jump = np.abs(before - 2 * here + after) > EDGE_M
        far = np.where(np.abs(before - here) > np.abs(after - here), before, after)
        np.moveaxis(edge, axis, 0)[1:-1] |= jump
        target = np.moveaxis(other, axis, 0)[1:-1]
        target[jump] = far[jump]
    return edge, other
