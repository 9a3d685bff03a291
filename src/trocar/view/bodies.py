"""The bodies of a scene at their poses."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.replay import Replay, Solid
from trocar.view.film import STILL_M, STILL_RAD, Film
from trocar.view.mesh import body_parts

if TYPE_CHECKING:
    from viser import SceneApi


class Bodies:
    """Bodies at their poses, at first those of frame 0: nodes ``/bodies/NAME`` in the world's frame.

    A node is moved once its body is more than ``STILL_M`` from where it is drawn, and turned once that differs by more
    than ``STILL_RAD``.
    """

    def __init__(self, scene: SceneApi, replay: Replay, film: Film) -> None:
        self._scene = scene
        self._drawn: dict[str, tuple[Hashable, Any]] = {}  # what each body looks like, and its node
        self.begin(replay, film)

    def begin(self, replay: Replay, film: Film) -> None:
        """Show another scene from now on; only bodies that look different than before are drawn again."""
        self._moved = film.moved
        # browsers draw in single precision
        self._position_m, self._wxyz = film.position_m.astype(np.float32), film.wxyz.astype(np.float32)
        solids: dict[str, list[Solid]] = {}
        for solid in replay.solids:
            solids.setdefault(solid.body, []).append(solid)
        looks = {body: tuple(map(_look, some)) for body, some in solids.items()}
        for body in [body for body, (look, _) in self._drawn.items() if looks.get(body) != look]:
            self._drawn.pop(body)[1].remove()
        new = body_parts(solid for solid in replay.solids if solid.body not in self._drawn)
        for body, look in looks.items():
            T = replay.T_world_body[body]
            T = SE3.unchecked(T.matrix[film.ticks[0]]) if body in film.bodies else T
            position, wxyz = T.translation_m, T.rotation.as_quaternion()
            if body in self._drawn:
                node = self._drawn[body][1]
                node.position, node.wxyz = position, wxyz
                continue
            name = "/bodies/" + body.replace("/", "|")  # a slash would attach one body to another
            self._drawn[body] = look, self._scene.add_frame(name, show_axes=False, position=position, wxyz=wxyz)
            for number, ((*rgb, alpha), mesh) in enumerate(new[body].items()):
                colour, opacity = np.rint(255 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8), alpha if alpha < 1 else None
                part = f"{name}/{number}"
                self._scene.add_mesh_simple(part, mesh.vertices_m, mesh.faces, color=colour, opacity=opacity)
        self._nodes = [self._drawn[body][1] for body in film.bodies]
        self._drawn_m, self._drawn_wxyz = self._position_m[:, 0].copy(), self._wxyz[:, 0].copy()

    def moved(self, frame: int) -> Iterator[tuple[str, NDArray[np.float32], NDArray[np.float32]]]:
        """Yield name, position (3,) m and wxyz (4,) of the nodes that have moved since the previous frame."""
        for i in np.flatnonzero(self._moved[:, frame]).tolist():
            yield self._nodes[i].name, self._position_m[i, frame], self._wxyz[i, frame]

    def show(self, frame: int) -> None:
        """Move all bodies to their poses at a frame."""
        self.place(self._position_m[:, frame], self._wxyz[:, frame])

    def place(self, position_m: NDArray[np.float32], wxyz: NDArray[np.float32]) -> None:
        """Move the film's bodies, in its order, to these positions (m, 3) and orientations (m, 4)."""
        moved = np.linalg.norm(position_m - self._drawn_m, axis=1) > STILL_M
        turned = 2 * np.linalg.norm(wxyz - self._drawn_wxyz, axis=1) > STILL_RAD  # |dq| is half a small angle
        for i in np.flatnonzero(moved).tolist():
            self._nodes[i].position = position_m[i]
        for i in np.flatnonzero(turned).tolist():
            self._nodes[i].wxyz = wxyz[i]
        self._drawn_m[moved], self._drawn_wxyz[turned] = position_m[moved], wxyz[turned]


def _look(solid: Solid) -> Hashable:
    """Return all that a solid's drawing on its body depends on."""
    placed = solid.T_body_solid.matrix.tobytes(), solid.vertices_m.tobytes()
    return solid.shape, tuple(solid.size_m), tuple(solid.rgba), *placed
