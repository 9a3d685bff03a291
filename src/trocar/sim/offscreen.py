"""Pictures of a replay for people; no agent gets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.lab import SensorFlaws
from trocar.perception.image import Intrinsics
from trocar.replay import Replay, Solid, Viewpoint, painted
from trocar.sim.ray_camera import RayCamera
from trocar.sim.sensor import Light
from trocar.sim.spec import INTANGIBLE, SHAPES, digits, placed

AMBIENT, GAIN = 0.6, 0.8
LAMP = np.array([-0.25, -0.2, 0.1])
"""Position of the lamp in the camera's frame, as a share of the distance to the middle of the scene: to the left of the
camera and above it. It is close enough to the camera that no arm's drive unit stands in its light."""
TABLE_RGB = (0.80, 0.83, 0.86)
BELOW_M = 2e-3
"""The table is this far below the lowest fixed solid."""
FAR = 3.2
"""Default distance of the eye, as a multiple of the width of what is shown."""
ROOM_M = 0.02
"""Least half-width of what is shown; less would show only a tip."""
BESIDE_M = 0.01
"""Shown on each side of where tips and bodies were: half a small body, and what a tip touches (assumed)."""

WIDTH = 640
"""Width of a picture in pixels at scale 1."""
HEIGHTS = (0.56, 0.75)
"""Least and greatest height as a share of the width: flat objects get a flat picture, tall ones at most 4:3."""
FILLED = 0.94
"""Share of the frame to fill; the rest is margin."""
NEAREST_M = 0.02
"""Points nearer to the camera, or behind it, count as this far away."""
AIMS = 6
"""Iterations of aiming: turning the camera to the middle of the points shifts that middle, less each time."""


class OffscreenCamera:
    """Draws a replay at any of its times by ray casting, with light and shadow, without OpenGL.

    Args:
        replay: the replay to draw.
        view: viewpoint; None: from the front and above.
        colours: colours in place of the solids' own, an argument of ``trocar.replay.painted``.
        scale: factor on the picture's width of 640 pixels.
        frame_m: (n, 3) points in the world that fill the picture; None: those of :func:`handled`.
    """

    def __init__(
        self,
        replay: Replay,
        view: Viewpoint | None = None,
        colours: Mapping[str, tuple[float, float, float]] | None = None,
        scale: float = 1.0,
        frame_m: Array | None = None,
    ):
        frame_m = handled(replay) if frame_m is None else frame_m
        view = view or overview(frame_m)
        self._replay, self._model = replay, _spec(replay, colours or {}).compile()
        self._data = mujoco.MjData(self._model)
        self._moving = [body for body, T in replay.T_world_body.items() if T.matrix.ndim == 3]
        T_world_camera, lens = framed(np.array(view.eye_m), frame_m, scale)
        middle_m = T_world_camera.inverse().apply(frame_m.mean(axis=0))
        lamp_m = LAMP * np.linalg.norm(middle_m)
        light = Light(AMBIENT, GAIN, reference_m=float(np.linalg.norm(middle_m - lamp_m)))
        flaws = replace(SensorFlaws.none(), shadow=True)
        self._camera = RayCamera(self._model, lens, T_world_camera, lamp_m, flaws, light)

    def picture(self, time_s: float, replay: Replay | None = None) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3) of a time, of this replay or of another one of the same cell."""
        replay = replay or self._replay
        row = int(np.argmin(np.abs(replay.times_s - time_s)))
        for number, body in enumerate(self._moving):
            T = replay.T_world_body[body][row]
            self._data.qpos[7 * number : 7 * number + 3] = T.translation_m
            self._data.qpos[7 * number + 3 : 7 * number + 7] = T.rotation.as_quaternion()
        mujoco.mj_kinematics(self._model, self._data)
        return self._camera.render(self._data, np.random.default_rng(0)).color


def handled(replay: Replay) -> Array:
    """Return the positions (n, 3) in the world of free bodies and moving tips, or else of all tips, or all bodies."""
    bodies, tools = replay.T_world_body, tuple(replay.tools)
    paths = [tool.p_world_driven_m for tool in replay.tools.values()]
    moved = [path for path in paths if np.ptp(path, axis=0).max() > ROOM_M]
    loose = [T.translation_m for name, T in bodies.items() if T.matrix.ndim == 3 and not name.startswith(tools)]
    points = np.concatenate([*moved, *loose] or paths or [T.matrix[None, :3, 3] for T in bodies.values()])
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    half = np.maximum((points.max(axis=0) - points.min(axis=0)) / 2 + BESIDE_M, ROOM_M)
    return np.concatenate([points, middle + half * np.array([[-1, -1, -1], [1, 1, 1]])])


def framed(eye_m: Array, points_m: Array, scale: float = 1.0) -> tuple[SE3, Intrinsics]:
    """Return pose and lens of a level camera in whose picture these points reach from edge to edge.

    Args:
        eye_m: (3,) position of the camera in the world.
        points_m: (n, 3) points in the world that fill the frame; two or more, in front of the eye.
        scale: factor on the picture's width of 640 pixels.
    """
    target = points_m.mean(axis=0)
    for _ in range(AIMS):
        T_world_camera = look_at(eye_m, target)
        low, high = _extent(T_world_camera, points_m)
        target = T_world_camera.apply(np.append((low + high) / 2, 1.0))
    T_world_camera = look_at(eye_m, target)
    low, high = _extent(T_world_camera, points_m)
    wide, tall = np.maximum(high - low, 1e-6)
    width = round(WIDTH * scale)
    height = round(width * float(np.clip(tall / wide, *HEIGHTS)))
    focal = FILLED * min(width / wide, height / tall)
    return T_world_camera, Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def look_at(eye_m: Array, target_m: Array) -> SE3:
    """Return ``T_world_camera`` (OpenCV axes) of a level camera at ``eye_m`` that looks at ``target_m``."""
    z = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3(np.column_stack([x, np.cross(z, x), z])), eye_m)


def _extent(T_world_camera: SE3, points_m: Array) -> tuple[Array, Array]:
    """Return the corners (2,), (2,) of the points' projections x/z, y/z."""
    seen = T_world_camera.inverse().apply(points_m)
    flat = seen[:, :2] / np.maximum(seen[:, 2:], NEAREST_M)
    return flat.min(axis=0), flat.max(axis=0)


def overview(points_m: Array) -> Viewpoint:
    """Return a viewpoint in front of and above these points (n, 3)."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    wide = max(0.06, float(np.linalg.norm(high - low)))
    eye = (low + high) / 2 + FAR * wide * np.array([0.25, -0.8, 0.55])
    return Viewpoint(tuple(eye.tolist()))  # type: ignore[arg-type]


def _spec(replay: Replay, colours: Mapping[str, tuple[float, float, float]]) -> mujoco.MjSpec:
    """Return the replay's solids on a table: moving ones as free bodies, the rest fixed."""
    spec = mujoco.MjSpec()
    hulls: dict[bytes, str] = {}
    bodies: dict[str, mujoco.MjsBody] = {}
    for name, T in replay.T_world_body.items():
        if T.matrix.ndim == 3:
            inertia = {"explicitinertial": True, "mass": 1, "inertia": (1, 1, 1)}
            bodies[name] = spec.worldbody.add_body(name=f"moving {name}", **inertia)
            bodies[name].add_freejoint()
        else:
            bodies[name] = spec.worldbody.add_body(name=f"fixed {name}", **placed(T))
    for solid in painted(replay.solids, colours):
        if solid.body in bodies:
            _add_solid(spec, bodies[solid.body], solid, hulls)
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": (2, 2, 0.01), "rgba": (*TABLE_RGB, 1)}
    spec.worldbody.add_geom(pos=digits((0, 0, _floor_m(replay) - BELOW_M)), **plane)
    return spec


def _add_solid(spec: mujoco.MjSpec, body: mujoco.MjsBody, solid: Solid, hulls: dict[bytes, str]) -> None:
    look = {"rgba": solid.rgba, **INTANGIBLE}
    if solid.shape != "hull":
        size = (*digits(solid.size_m), 0, 0)[:3]
        body.add_geom(type=SHAPES[solid.shape], size=size, **placed(solid.T_body_solid), **look)
        return
    # MuJoCo itself shifts a mesh to its centre of mass, so the corners are given in the body's frame
    corners = solid.T_body_solid.apply(solid.vertices_m)
    key = np.round(corners, 9).tobytes()
    if key not in hulls:
        hulls[key] = f"hull{len(hulls)}"
        spec.add_mesh(name=hulls[key], uservert=digits(corners).ravel())
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=hulls[key], **look)


def _floor_m(replay: Replay) -> float:
    """Return the height of the lowest fixed solid; if there is none, of the lowest tip."""
    fixed = {name: T for name, T in replay.T_world_body.items() if T.matrix.ndim == 2}
    lowest = [_lowest_m(fixed[solid.body], solid) for solid in replay.solids if solid.body in fixed]
    tips = [float(tool.p_world_driven_m[:, 2].min()) for tool in replay.tools.values()]
    return min(lowest or tips or [0.0])


def _lowest_m(T_world_body: SE3, solid: Solid) -> float:
    T_world_solid = T_world_body @ solid.T_body_solid
    if solid.shape in ("sphere", "capsule", "cylinder"):
        return float(T_world_solid.translation_m[2]) - max(solid.size_m)
    corners = solid.vertices_m if solid.shape == "hull" else np.array([*product((-1, 1), repeat=3)]) * solid.size_m
    return float(T_world_solid.apply(corners)[:, 2].min())
