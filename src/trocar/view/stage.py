"""The stage: a scene's bodies and their poses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.mesh import Part, body_parts
from trocar.view.overlay import HORIZON, SKY, ArmLabels, Contacts, Paths
from trocar.view.viewpoint import FIELD_RAD, Viewpoint, viewpoint

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer


class Bodies:
    """Bodies at their poses; those that move are nodes ``/bodies/NAME`` in the world's frame, first as in frame 0."""

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        self._scene, self._moved = scene, film.moved
        # the precision that a browser draws with
        self._position_m, self._wxyz = film.position_m.astype(np.float32), film.wxyz.astype(np.float32)
        parts = body_parts(replay.solids)
        for body in parts:
            if body not in film.bodies:
                self._draw(body, parts[body], replay.T_world_body[body])
        first = {body: SE3.unchecked(replay.T_world_body[body].matrix[film.ticks[0]]) for body in film.bodies}
        self._nodes = [self._draw(body, parts[body], first[body]) for body in film.bodies]

    def moved(self, frame: int) -> Iterator[tuple[str, NDArray[np.float32], NDArray[np.float32]]]:
        """Yield name, position (3,) m and wxyz (4,) of the nodes that have moved since the previous frame."""
        for i in np.flatnonzero(self._moved[:, frame]).tolist():
            yield self._nodes[i].name, self._position_m[i, frame], self._wxyz[i, frame]

    def show(self, frame: int) -> None:
        """Move all bodies to their poses at a frame."""
        for node, position, wxyz in zip(self._nodes, self._position_m[:, frame], self._wxyz[:, frame], strict=True):
            node.position, node.wxyz = position, wxyz

    def _draw(self, body: str, parts: list[Part], T_world_body: SE3) -> Any:
        """Add a body to the scene and return its node."""
        name = "/bodies/" + body.replace("/", "|")  # a slash would attach one body to another
        position, wxyz = T_world_body.translation_m, T_world_body.rotation.as_quaternion()
        node = self._scene.add_frame(name, show_axes=False, position=position, wxyz=wxyz)
        for number, part in enumerate(parts):
            *rgb, alpha = part.rgba
            colour, opacity = np.rint(255 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8), alpha if alpha < 1 else None
            mesh = part.mesh.vertices_m, part.mesh.faces
            self._scene.add_mesh_simple(f"{name}/{number}", *mesh, color=colour, opacity=opacity)
        return node


LAMP = (-0.9, 1.6, 3.6)
"""Position of the lamp that casts shadows: right, front and up from the workspace's middle, in its radii."""

LIT = 3.0  # radii of the workspace that the lamp reaches


class Stage:
    """Everything that is drawn of a replay, first at the first frame of its film: bodies, and what is over them."""

    def __init__(self, server: ViserServer, replay: Replay, film: Film) -> None:
        self.film = film
        view, scene = viewpoint(replay, film), server.scene
        _look_from(server, view)
        _light(scene, view)
        self.bodies = Bodies(scene, replay, film)
        self._moments = (
            Paths(scene, replay, film),
            Contacts(scene, replay, film, 0.035 * view.radius_m),
            ArmLabels(scene, replay, film, 0.4 * view.radius_m),
        )

    def show(self, frame: int) -> None:
        """Show a frame, whatever was shown before."""
        self.bodies.show(frame)
        self.show_moments(frame)

    def show_moments(self, frame: int) -> None:
        """Show paths, contacts and labels of a frame, not its bodies."""
        for moment in self._moments:
            moment.show(frame)


def _look_from(server: ViserServer, view: Viewpoint) -> None:
    """Set the initial view of the page."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = view.eye_m, view.centre_m, (0.0, 0.0, 1.0)
    camera.fov = FIELD_RAD
    camera.near = 0.02 * float(np.linalg.norm(view.eye_m - view.centre_m))


def _light(scene: SceneApi, view: Viewpoint) -> None:
    """Light a scene like a photo studio: one lamp that casts shadows, and a plain background.

    viser's own lamps are made for scenes of metres: their shadows begin centimetres behind the object that casts them.
    """
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=0.3)
    scene.add_light_hemisphere("/light/sky", intensity=0.2, ground_color=(150, 150, 155))
    along, front, up = LAMP
    offset = view.radius_m * (along * view.right + front * view.front + up * np.array([0.0, 0.0, 1.0]))
    scene.add_light_spot(
        "/light/lamp",
        position=tuple((view.centre_m + offset).tolist()),
        direction=tuple((-offset).tolist()),
        intensity=1.4,
        angle=math.atan(LIT * view.radius_m / float(np.linalg.norm(offset))),
        penumbra=1.0,
        decay=0.0,
        cast_shadow=True,
    )
    height = np.linspace(0.0, 1.0, 128)[:, None, None]
    scene.set_background_image(np.tile((1 - height) * SKY + height * HORIZON, (1, 4, 1)).astype(np.uint8), "png")
