"""An RGBD camera that renders MuJoCo's world by casting rays, so that it needs neither OpenGL nor a display."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.lab.station import SensorFlaws
from trocar.perception.depth import pixel_rays
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.sim.appearance import Appearance, Sight
from trocar.sim.sensor import Light, apply_flaws, expose, shade

VISIBLE_GROUPS = (1, 1, 1, 0, 0, 0)
HIDDEN_GROUP = 5
NEAR_M = 5e-3
SHADOW_SLACK = 5e-4
"""A surface is lit unless the projector's ray ends before it by more than this share of the ray's length."""


class RayCamera:
    """A calibrated camera in a MuJoCo world.

    Args:
        model: the world; geoms of groups 0-2 are visible. Bodies welded to the world must not change.
        intrinsics: lens and pixels, such as ``lens.binned(2)``.
        T_world_camera: true pose.
        lamp_m: (3,) projector or lamp in the camera frame; surfaces that it does not light are dark and have no depth.
        flaws: the sensor's flaws; ``SensorFlaws.none()`` gives exact depth.
        light: the scene's light.
        finish: grain and wet spots of surfaces; None: plain colours.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        intrinsics: Intrinsics,
        T_world_camera: SE3,
        lamp_m: ArrayLike,
        flaws: SensorFlaws,
        light: Light | None = None,
        finish: Appearance | None = None,
    ):
        if T_world_camera.matrix.shape != (4, 4) or not np.isfinite(T_world_camera.matrix).all():
            raise InvalidInput("T_world_camera of a camera", "is not one finite pose (4, 4)", "give one")
        self.model, self.intrinsics, self.T_world_camera = model, intrinsics, T_world_camera
        self._lamp_m, self._finish = np.asarray(lamp_m, dtype=np.float64), finish
        self.flaws = flaws
        self.light = Light() if light is None else light
        R = T_world_camera.rotation.matrix
        self._T_world_projector = SE3.from_parts(T_world_camera.rotation, T_world_camera.apply(self._lamp_m))
        self._rays, self._raster, self._cell = _pixels(intrinsics)
        self._rays_world = np.ascontiguousarray(self._rays @ R.T)
        group = np.clip(model.geom_group, 0, 5)
        alpha = np.where(model.geom_matid >= 0, 1.0, model.geom_rgba[:, 3])
        seen = (np.array(VISIBLE_GROUPS)[group] > 0) & (alpha > 0)
        fixed = model.body_weldid[model.geom_bodyid] == 0
        self._moving = np.flatnonzero(seen & ~fixed)
        self._groups = np.array(VISIBLE_GROUPS, dtype=np.uint8)
        self._fixed_model = copy.copy(model)
        self._fixed_model.geom_group[~fixed] = HIDDEN_GROUP
        self._fixed: dict[bool, _View] = {}  # with the projector's shadows, and without
        self._lamp_map: tuple[_Raster, NDArray[np.intp]] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Return (height, width) in pixels."""
        return self.intrinsics.height, self.intrinsics.width

    def binned(self, factor: int) -> RayCamera:
        """Return this camera with ``factor`` x ``factor`` pixels combined into one, with the ray and noise of one."""
        lens = self.intrinsics.binned(factor)
        return RayCamera(self.model, lens, self.T_world_camera, self._lamp_m, self.flaws, self.light, self._finish)

    def cropped(self, data: mujoco.MjData, corner_px: tuple[int, int], size_px: tuple[int, int]) -> RayCamera:
        """Return this camera with only a rectangle of its pixels read out.

        Args:
            data: any state of the world; fixed objects are rendered once for all overlapping rectangles.
            corner_px: (u, v) of the rectangle's first pixel.
            size_px: (width, height).
        """
        (u, v), (width, height), whole = corner_px, size_px, self.size

        def part(values: NDArray) -> NDArray:
            rectangle = values.reshape(*whole, *values.shape[1:])[v : v + height, u : u + width]
            return rectangle.reshape(-1, *values.shape[1:])

        camera = copy.copy(self)
        camera.intrinsics = self.intrinsics.cropped(corner_px, size_px)
        camera._rays, camera._rays_world = part(self._rays), part(self._rays_world)
        camera._raster, camera._cell = self._raster.part(part(self._cell))
        shadow = self.flaws.shadow
        camera._fixed = {shadow: self._fixed_seen(data, shadow, part(np.arange(len(self._rays)))).each(part)}
        camera._lamp_map = None
        return camera

    def render(self, data: mujoco.MjData, rng: np.random.Generator) -> RgbdImage:
        """Return the image that the sensor delivers, with flaws drawn from ``rng``."""
        view, shape = self._view(data, shadow=self.flaws.shadow), self.size
        exact, cosine = view.depth.reshape(shape), view.cosine.reshape(shape)
        lit, mirror = view.lit.reshape(shape), view.mirror.reshape(shape)
        depth, color = apply_flaws(self.flaws, exact, view.color.reshape(*shape, 3), cosine, lit, mirror, rng)
        return RgbdImage(color, depth, self.intrinsics, float(data.time))

    def render_color(self, data: mujoco.MjData, rng: np.random.Generator, gain: float = 1.0) -> NDArray[np.uint8]:
        """Return a colour picture (h, w, 3) without depth, blurred by the lens, with its own noise and gain."""
        view = self._view(data, shadow=self.flaws.shadow)
        return expose(view.color.reshape(*self.size, 3) * np.float32(gain), self.flaws.color_sd, rng)

    def render_exact(self, data: mujoco.MjData) -> tuple[Array, NDArray[np.int32], NDArray[np.uint8]]:
        """Return depth (h, w) in m, geom ids (h, w) and colour (h, w, 3); NaN and -1 where nothing is hit."""
        view, shape = self._view(data, shadow=False), self.size
        color = np.rint(view.color * 255).astype(np.uint8)
        return view.depth.reshape(shape), view.geom.reshape(shape), color.reshape(*shape, 3)

    def _view(self, data: mujoco.MjData, shadow: bool) -> _View:
        """Return what the pixels see; only those where something may have moved are cast again."""
        fixed = self._fixed_seen(data, shadow)
        view = fixed.each(np.copy)
        covered = self._raster.covered(self.model, data, self._moving, self.T_world_camera)[self._cell]
        active = np.flatnonzero(covered)
        self._see(view, self.model, data, active)
        if shadow:
            raster, cell = self._projector_map(fixed)
            dark = raster.covered(self.model, data, self._moving, self._T_world_projector)
            active = np.concatenate([active, np.flatnonzero(dark[cell] & ~covered & fixed.lit)])
        self._shade(view, self.model, data, active, shadow)
        return view

    def _fixed_seen(self, data: mujoco.MjData, shadow: bool, pixels: NDArray[np.intp] | None = None) -> _View:
        """Return what these pixels (None: all) see of fixed objects; each pixel is cast only once."""
        if shadow not in self._fixed:
            self._fixed[shadow] = _View.unseen(len(self._rays))
        fixed = self._fixed[shadow]
        new = np.flatnonzero(~fixed.cast) if pixels is None else pixels[~fixed.cast[pixels]]
        if len(new):
            self._see(fixed, self._fixed_model, data, new)
            self._shade(fixed, self._fixed_model, data, new, shadow)
        return fixed

    def _see(self, view: _View, model: mujoco.MjModel, data: mujoco.MjData, pixels: NDArray[np.intp]) -> None:
        """Fill in depth, geom and normal of what these pixels' rays hit."""
        view.depth[pixels], view.geom[pixels], view.normal_world[pixels] = self._cast(
            model, data, self.T_world_camera.translation_m, self._rays_world[pixels]
        )
        view.cast[pixels] = True

    def _shade(
        self, view: _View, model: mujoco.MjModel, data: mujoco.MjData, pixels: NDArray[np.intp], shadow: bool
    ) -> None:
        """Fill in light, colour, specular reflection and incidence of these pixels."""
        depth, geom, normal_world = view.depth[pixels], view.geom[pixels], view.normal_world[pixels]
        lit = self._lit(model, data, depth, normal_world, pixels) if shadow else np.isfinite(depth)
        R = self.T_world_camera.rotation.matrix
        normal, rays = normal_world @ np.ascontiguousarray(R), self._rays[pixels]
        color, mirror = shade(self.model, rays, depth, geom, normal, lit, self._lamp_m, self.light)
        if self._finish is not None:
            eye_m, lamp_m = self.T_world_camera.translation_m, self._T_world_projector.translation_m
            points = np.nan_to_num(rays * depth[:, None]) @ np.ascontiguousarray(R.T)
            points += eye_m
            color = self._finish.apply(data, color, Sight(geom, points, normal_world, eye_m, lamp_m, lit))
        view.lit[pixels], view.color[pixels], view.mirror[pixels] = lit, color, mirror
        view.cosine[pixels] = -np.einsum("ij,ij->i", rays, normal) / np.sqrt(_squared(rays))

    def _projector_map(self, fixed: _View) -> tuple[_Raster, NDArray[np.intp]]:
        """Return a map of the projector's directions to fixed objects, and the cell (n,) of each pixel's point in it.

        All pixels must have been cast before.
        """
        if self._lamp_map is None:
            depth = np.where(np.isfinite(fixed.depth), fixed.depth, 1.0)
            x, y, z = (self._rays[:, axis] * depth - self._lamp_m[axis] for axis in range(3))
            across, down = x / z, y / z
            shown = (across[fixed.lit], down[fixed.lit]) if fixed.lit.any() else _directions(self._rays)
            raster = _Raster(*shown, self.intrinsics.fx)
            self._lamp_map = raster, raster.index(across, down)
        return self._lamp_map

    def _cast(
        self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, rays: Array
    ) -> tuple[Array, NDArray[np.int32], Array]:
        """Return distances (n,) in ray lengths, geoms (n,) and normals (n, 3); NaN, -1 and 0 where nothing is hit."""
        count = len(rays)
        geom, distance, normal = np.full(count, -1, dtype=np.int32), np.full(count, -1.0), np.zeros(3 * count)
        if count:
            flat, groups, far = np.ascontiguousarray(rays).ravel(), self._groups, mujoco.mjMAXVAL
            mujoco.mj_multiRay(model, data, origin, flat, groups, True, -1, geom, distance, normal, count, far)
        distance[distance < 0] = np.nan
        return distance, geom, normal.reshape(-1, 3)

    def _lit(
        self, model: mujoco.MjModel, data: mujoco.MjData, depth: Array, normal_world: Array, pixels: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Return which of these pixels' surfaces the projector reaches, by rays from the projector."""
        lit = np.isfinite(depth)
        seen = np.flatnonzero(lit)
        rays = self._rays[pixels[seen]] * depth[seen, None] - self._lamp_m
        world = rays @ np.ascontiguousarray(self._T_world_projector.rotation.matrix.T)
        facing = np.einsum("ij,ij->i", world, normal_world[seen]) < 0
        distance, *_ = self._cast(model, data, self._T_world_projector.translation_m, world)
        lit[seen] = facing & ~(distance < 1 - SHADOW_SLACK)
        return lit


@dataclass(frozen=True)
class _View:
    """What each pixel (n,) sees, whether it is lit, and whether its ray was cast; normal and colour are (n, 3)."""

    depth: Array
    geom: NDArray[np.int32]
    normal_world: Array
    color: NDArray[np.float32]
    mirror: NDArray[np.float32]
    cosine: NDArray[np.float32]
    lit: NDArray[np.bool_]
    cast: NDArray[np.bool_]

    @staticmethod
    def unseen(n: int) -> _View:
        color, mirror, cosine = (np.zeros(shape, np.float32) for shape in ((n, 3), n, n))
        geom, normal = np.full(n, -1, np.int32), np.zeros((n, 3))
        return _View(np.full(n, np.nan), geom, normal, color, mirror, cosine, np.zeros(n, bool), np.zeros(n, bool))

    def each(self, change: Callable[[NDArray], NDArray]) -> _View:
        """Return the view with each of its arrays changed."""
        return _View(*(change(getattr(self, field.name)) for field in fields(self)))


class _Raster:
    """A coarse map of directions x/z, y/z, in which solids' outlines are drawn, conservatively large."""

    CELL_PIXELS = 2.0
    MARGIN_CELLS = 4

    def __init__(self, x: Array, y: Array, focal_px: float):
        """Make the map that contains these directions (n,), in cells of ``CELL_PIXELS`` at this focal length."""
        self.scale = focal_px / self.CELL_PIXELS
        margin = self.MARGIN_CELLS / self.scale
        self.lower = np.array([x.min(), y.min()]) - margin
        upper = np.array([x.max(), y.max()]) + margin
        columns, rows = np.ceil((upper - self.lower) * self.scale).astype(int) + 2
        self.shape = (int(rows), int(columns))

    def part(self, cells: NDArray[np.intp]) -> tuple[_Raster, NDArray[np.intp]]:
        """Return the smallest map that contains these cells, and their indices in it."""
        outside = cells == self.shape[0] * self.shape[1]
        row, column = np.divmod(cells, self.shape[1])
        inside = ~outside
        if not inside.any():
            return self, cells
        top, left = (max(0, int(at[inside].min()) - self.MARGIN_CELLS) for at in (row, column))
        bottom, right = (int(at[inside].max()) + 1 + self.MARGIN_CELLS for at in (row, column))
        smaller = copy.copy(self)
        smaller.lower, smaller.shape = self.lower + np.array([left, top]) / self.scale, (bottom - top, right - left)
        numbers = (row - top) * smaller.shape[1] + column - left
        return smaller, np.where(outside, smaller.shape[0] * smaller.shape[1], numbers)

    def index(self, x: Array, y: Array) -> NDArray[np.intp]:
        """Return the flat cell of each direction (n,); those off the map share a cell that is always cast."""
        rows, columns = self.shape
        column, row = (
            np.floor((values - lower) * self.scale).astype(np.intp)
            for values, lower in zip((x, y), self.lower, strict=True)
        )
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(inside, row * columns + column, rows * columns)

    def covered(
        self, model: mujoco.MjModel, data: mujoco.MjData, solids: NDArray[np.intp], T_world_eye: SE3
    ) -> NDArray[np.bool_]:
        """Return for each flat cell whether a ray through it may hit one of these solids, by their bounding boxes."""
        pick = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)]) * 2 - 1
        edges = [(i, i | (1 << k)) for i in range(8) for k in range(3) if not i & (1 << k)]
        boxes = model.geom_aabb[solids]
        local = boxes[:, None, :3] + pick * boxes[:, None, 3:]
        frames = data.geom_xmat[solids].reshape(-1, 3, 3)
        world = np.einsum("gij,gkj->gki", frames, local) + data.geom_xpos[solids][:, None]
        corners = (world - T_world_eye.translation_m) @ T_world_eye.rotation.matrix
        canvas = np.zeros(self.shape, dtype=np.uint8)
        for box in corners:
            points = box[box[:, 2] >= NEAR_M]
            if not len(points):
                continue
            if len(points) < 8:
                ends = np.array([(box[a], box[b]) for a, b in edges if (box[a, 2] < NEAR_M) != (box[b, 2] < NEAR_M)])
                share = (NEAR_M - ends[:, 0, 2]) / (ends[:, 1, 2] - ends[:, 0, 2])
                points = np.concatenate([points, ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])])
            flat = (points[:, :2] / points[:, 2:] - self.lower) * self.scale
            cv2.fillConvexPoly(canvas, cv2.convexHull(np.floor(flat).astype(np.int32)), 1)
        canvas = cv2.dilate(canvas, np.ones((5, 5), np.uint8))
        return np.append(canvas.ravel() > 0, True)


def _directions(rays: Array) -> tuple[Array, Array]:
    """Return x/z and y/z, each (n,), of rays (n, 3); column by column, since numpy is slow along short axes."""
    return rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]


def _squared(rays: Array) -> Array:
    """Return the squared lengths (n,) of rays (n, 3)."""
    return rays[:, 0] ** 2 + rays[:, 1] ** 2 + rays[:, 2] ** 2


@lru_cache(maxsize=8)
def _pixels(intrinsics: Intrinsics) -> tuple[Array, _Raster, NDArray[np.intp]]:
    """Return a lens's rays (n, 3), its map, and the cell (n,) of each ray; many worlds share a lens."""
    rays = pixel_rays(intrinsics).reshape(-1, 3)
    directions = _directions(rays)
    raster = _Raster(*directions, intrinsics.fx)
    cells = raster.index(*directions)
    cells.setflags(write=False)
    return rays, raster, cells
