"""Which fragments a camera could see: rays from its eyes to points on them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.sim.world import World
from trocar.tasks.debridement.truth import Sights

LOOK_S = 0.5
"""The referee looks so often; arms take seconds to pass over a fragment."""
POINTS = 8
"""Corners of each fragment that are looked at."""
GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)


class Looks:
    """Looks from all eyes now and then.

    Args:
        world: arms and fragments in their places.
        vertices_m: corners (n, 3) of each fragment in its own frame.
        p_world_eyes_m: (e, 3).
    """

    def __init__(self, world: World, vertices_m: list[NDArray[np.float64]], p_world_eyes_m: NDArray[np.float64]):
        self._world, self._eyes_m = world, p_world_eyes_m
        self._points_m = [corners[np.argsort(-corners[:, 2])[:POINTS]] for corners in vertices_m]  # those on top
        self._geom = [world.model.geom(f"fragment{k}").id for k in range(len(vertices_m))]
        self._body = [world.model.body(f"fragment{k}").id for k in range(len(vertices_m))]
        self._times: list[float] = []
        self._seen: list[list[float]] = []

    def observe(self, time_s: float) -> None:
        """Look, if it is time again."""
        if len(self._eyes_m) and (not self._times or time_s - self._times[-1] > LOOK_S - 1e-9):
            self._times.append(time_s)
            self._seen.append([self._share(k) for k in range(len(self._geom))])

    def sights(self) -> Sights:
        """Return all so far."""
        return Sights(np.array(self._times), np.array(self._seen).reshape(len(self._times), len(self._geom)))

    def _share(self, fragment: int) -> float:
        """Return the share of a fragment's points that the eye sees that sees least: stereo takes both."""
        data, geom, body = self._world.data, self._geom[fragment], self._body[fragment]
        points = self._points_m[fragment] @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        middle = points.mean(axis=0)
        return min(self._seen_from(eye, middle + 0.8 * (points - middle), geom) for eye in self._eyes_m)

    def _seen_from(self, eye_m: NDArray[np.float64], points_m: NDArray[np.float64], geom: int) -> float:
        ways, hit = points_m - eye_m, np.zeros(1, dtype=np.int32)
        found = 0
        for way in ways:
            mujoco.mj_ray(self._world.model, self._world.data, eye_m, way, GROUPS, 1, -1, hit, None)
            found += int(hit[0] == geom)
        return found / len(ways)
