"""Surroundings of a scene that are not among a trial's solids: the table, and the ports that the shafts go through."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import TURN
from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.mesh import Mesh, box, tube
from trocar.view.viewpoint import fixed_corners, objects, ports

if TYPE_CHECKING:
    from viser import SceneApi

TABLE = (150, 158, 168)
THICK_M, BELOW_M = 4e-3, 0.5e-3
"""Thickness of the table, and how far it is below what stands on it: faces in one plane would flicker."""
BEYOND = 0.35
"""The table reaches beyond what stands on it, and beyond the ports, by this share of their extent."""
PORT = (58, 64, 74)
RING_M = (7.5e-3, 2e-3)
"""Radii of a port's ring and of its rim; a shaft of 8 mm passes through it at any angle that an arm reaches."""
SIDES = 32


def lay_table(scene: SceneApi, replay: Replay, film: Film) -> None:
    """Draw a table below the fixed solids, if there are any, that extends below all objects and ports."""
    corners = fixed_corners(replay, film)
    if not len(corners):
        return
    around = np.concatenate([corners, objects(replay, film), ports(replay)])[:, :2]
    low, high = around.min(0), around.max(0)
    half = np.append((0.5 + BEYOND) * (high - low), THICK_M / 2)
    top = corners[:, 2].min() - BELOW_M
    middle = (*((low + high) / 2).tolist(), float(top - half[2]))
    slab = box(half)
    scene.add_mesh_simple("/table", slab.vertices_m, slab.faces, color=TABLE, position=middle, cast_shadow=False)


def add_ports(scene: SceneApi, replay: Replay, film: Film) -> None:
    """Draw a ring at each arm's remote centre, across the mean direction of its shaft: nodes ``/ports/ARM``."""
    for arm, port_m in replay.ports_m.items():
        along = _along_shaft(replay, film, arm)
        if along is not None:
            mesh = ring(*RING_M, along)
            scene.add_mesh_simple(
                f"/ports/{arm}", mesh.vertices_m, mesh.faces, color=PORT, position=tuple(port_m.tolist())
            )


def _along_shaft(replay: Replay, film: Film, arm: str) -> NDArray[np.float64] | None:
    """Return the mean direction (3,) from an arm's wrist to its port; None if the wrist's pose is unknown."""
    wrist = replay.T_world_body.get(f"{arm}_link4")
    if wrist is None:
        return None
    at = wrist.translation_m.reshape(-1, 3)
    away = replay.ports_m[arm] - at[film.ticks if len(at) > 1 else slice(None)]
    return (away / np.linalg.norm(away, axis=1, keepdims=True)).mean(0)


def ring(radius_m: float, rim_m: float, axis: NDArray[np.float64]) -> Mesh:
    """Return a ring about the origin, across an axis (3,)."""
    axis = axis / np.linalg.norm(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    angle = np.arange(SIDES + 1)[:, None] * (TURN / SIDES)
    circle = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    return tube(radius_m * circle, rim_m, 12)
