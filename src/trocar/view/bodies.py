"""The bodies of a replay in a viser scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.solids import Part, body_parts

if TYPE_CHECKING:
    from viser import SceneApi


class Bodies:
    """Bodies at their poses; those that move are nodes ``/bodies/NAME`` in the world's frame.

    Attributes:
        film: their poses at each frame.
    """

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        """Draw all bodies; those that move, at the first frame."""
        self.film, self._scene = film, scene
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
        for i in np.flatnonzero(self.film.moved[:, frame]).tolist():
            yield self._nodes[i].name, self._position_m[i, frame], self._wxyz[i, frame]

    def show(self, frame: int) -> None:
        """Move all bodies to their poses at a frame."""
        for node, position, wxyz in zip(self._nodes, self._position_m[:, frame], self._wxyz[:, frame], strict=True):
            node.position, node.wxyz = position, wxyz

    def _draw(self, body: str, parts: list[Part], T_world_body: SE3) -> Any:
        """Add a body to the scene and return its node."""
        node = self._scene.add_frame(
            node_name(body),
            show_axes=False,
            position=T_world_body.translation_m,
            wxyz=T_world_body.rotation.as_quaternion(),
        )
        for number, part in enumerate(parts):
            *rgb, alpha = part.rgba
            self._scene.add_mesh_simple(
                f"{node_name(body)}/{number}",
                part.mesh.vertices_m,
                part.mesh.faces,
                color=np.rint(255 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8),
                opacity=alpha if alpha < 1 else None,
            )
        return node


def node_name(body: str) -> str:
    """Return the name of a body's node; a slash in it would attach one body to another."""
    return "/bodies/" + body.replace("/", "|")
