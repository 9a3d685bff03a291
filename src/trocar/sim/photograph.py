"""Pictures of a trial for people, from its replay; no agent gets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.perception.image import Intrinsics
from trocar.replay import Replay, Solid, Viewpoint
from trocar.sim.camera import RayCamera
from trocar.sim.elements import add, placed, text
from trocar.sim.sensor import Light
from trocar.station import SensorFlaws

WIDTH, HEIGHT, FOCAL = 640, 480, 1520.0
AMBIENT = 0.42
LAMP_M = (0.12, 0.0, 0.0)
TABLE_RGB = (0.30, 0.33, 0.36)
BELOW_M = 2e-3
"""The table lies this much below the lowest solid that does not move."""
FAR = 3.2
"""Without a view of the task's own the eye stands so many times as far away as the motion is wide."""


class Photographer:
    """Draws a replay at any of its times: rays, light and shadow, no OpenGL.

    Args:
        replay: what is drawn.
        view: from where; None: from where all that moves can be seen.
        colours: of bodies, in place of their own, by the beginning of their names.
        scale: of the picture's 640 x 480 pixels.
    """

    def __init__(
        self,
        replay: Replay,
        view: Viewpoint | None = None,
        colours: Mapping[str, tuple[float, float, float]] | None = None,
        scale: float = 1.0,
    ):
        view = view or overview(replay)
        self._replay = replay
        self._model = mujoco.MjModel.from_xml_string(_mjcf(replay, colours or {}))
        self._data = mujoco.MjData(self._model)
        self._moving = [body for body, T in replay.T_world_body.items() if T.matrix.ndim == 3]
        size = round(WIDTH * scale), round(HEIGHT * scale)
        lens = Intrinsics(*size, FOCAL * scale, FOCAL * scale, (size[0] - 1) / 2, (size[1] - 1) / 2)
        light = Light(ambient=AMBIENT, gain=view.gain)
        flaws = replace(SensorFlaws.none(), shadow=True)
        self._camera = RayCamera(
            self._model, lens, look_at(np.array(view.eye_m), np.array(view.target_m)), LAMP_M, flaws, light
        )

    def picture(self, time_s: float) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3) of what was at this time."""
        row = int(np.argmin(np.abs(self._replay.times_s - time_s)))
        for number, body in enumerate(self._moving):
            T = self._replay.T_world_body[body][row]
            self._data.qpos[7 * number : 7 * number + 3] = T.translation_m
            self._data.qpos[7 * number + 3 : 7 * number + 7] = T.rotation.as_quaternion()
        mujoco.mj_kinematics(self._model, self._data)
        return self._camera.render(self._data, np.random.default_rng(0)).color


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64]) -> SE3:
    """Return ``T_world_camera`` (OpenCV axes) of a level camera at ``eye_m`` that looks at ``target_m``."""
    z = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3.from_parts(SO3.unchecked(np.column_stack([x, np.cross(z, x), z])), eye_m)


def overview(replay: Replay) -> Viewpoint:
    """Return a viewpoint in front and above, so that the tips' paths fill the picture."""
    paths = [tool.p_world_driven_m for tool in replay.tools.values()]
    points = np.concatenate([*paths, [T.translation_m for T in replay.T_world_body.values() if T.matrix.ndim == 2]])
    if paths:
        points = np.concatenate(paths)
    middle = (points.max(0) + points.min(0)) / 2
    wide = max(0.06, float(np.linalg.norm(np.ptp(points, axis=0))))
    eye = middle + FAR * wide * np.array([0.25, -0.8, 0.55])
    return Viewpoint(tuple(eye.tolist()), tuple(middle.tolist()))  # type: ignore[arg-type]


def _mjcf(replay: Replay, colours: Mapping[str, tuple[float, float, float]]) -> str:
    """Return the replay's solids as MJCF: what moves as free bodies, the rest fixed, on a table."""
    root = Element("mujoco", model="replay")
    add(root, "compiler", angle="radian")
    assets, world = add(root, "asset"), add(root, "worldbody")
    hulls: dict[bytes, str] = {}
    bodies: dict[str, Element] = {}
    for name, T in replay.T_world_body.items():
        if T.matrix.ndim == 3:
            bodies[name] = add(world, "body", name=f"moving {name}")
            add(bodies[name], "freejoint")
            add(bodies[name], "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        else:
            bodies[name] = add(world, "body", name=f"fixed {name}", **placed(T))
    for solid in replay.solids:
        if solid.body in bodies:
            rgb = next((rgb for prefix, rgb in colours.items() if solid.body.startswith(prefix)), solid.rgba[:3])
            _add_solid(bodies[solid.body], assets, solid, rgb, hulls)
    add(
        world,
        "geom",
        type="plane",
        size="2 2 0.01",
        pos=text((0, 0, _floor_m(replay) - BELOW_M)),
        rgba=text((*TABLE_RGB, 1)),
    )
    return tostring(root, encoding="unicode")


def _add_solid(body: Element, assets: Element, solid: Solid, rgb: tuple[float, ...], hulls: dict[bytes, str]) -> None:
    look = {"rgba": text((*rgb, solid.rgba[3])), "contype": "0", "conaffinity": "0"}
    if solid.shape != "hull":
        add(body, "geom", type=solid.shape, size=text(solid.size_m), **placed(solid.T_body_solid), **look)
        return
    # MuJoCo shifts a mesh to its centre of mass by itself: the corners are given where they are on the body
    corners = solid.T_body_solid.apply(solid.vertices_m)
    key = np.round(corners, 9).tobytes()
    if key not in hulls:
        hulls[key] = f"hull{len(hulls)}"
        add(assets, "mesh", name=hulls[key], vertex=text(corners))
    add(body, "geom", type="mesh", mesh=hulls[key], **look)


def _floor_m(replay: Replay) -> float:
    """Return the height of the lowest solid that does not move; without any, of the lowest tip."""
    lowest = [
        float((replay.T_world_body[s.body] @ s.T_body_solid).translation_m[2]) - max(s.size_m, default=0.0)
        if s.shape in ("sphere", "capsule", "cylinder")
        else _lowest_corner_m(replay, s)
        for s in replay.solids
        if s.body in replay.T_world_body and replay.T_world_body[s.body].matrix.ndim == 2
    ]
    tips = [float(tool.p_world_driven_m[:, 2].min()) for tool in replay.tools.values()]
    return min(lowest or tips or [0.0])


def _lowest_corner_m(replay: Replay, solid: Solid) -> float:
    signs = np.array([[(i >> k & 1) * 2 - 1 for k in range(3)] for i in range(8)])
    corners = solid.vertices_m if solid.shape == "hull" else signs * np.array(solid.size_m)
    return float((replay.T_world_body[solid.body] @ solid.T_body_solid).apply(corners)[:, 2].min())
