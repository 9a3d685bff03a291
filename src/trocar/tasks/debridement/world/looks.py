"""The fragments that a camera could see, by rays from its eyes to points on them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.sim.world import World
from trocar.tasks.debridement.truth import Sights

LOOK_S = 0.5
"""Interval of the referee's checks; arms take seconds to pass over a fragment."""
POINTS = 8
"""Number of each fragment's corners that are checked."""
GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)


class Looks:
    """Checks visibility from all eyes at intervals.

    Args:
        world: arms and fragments in their places.
        vertices_m: corners (n, 3) of each fragment in its own frame.
        p_world_eyes_m: (e, 3).
    """

    def __init__(self, world: World, vertices_m: list[NDArray[np.float64]], p_world_eyes_m: NDArray[np.float64]):
        self._world, self._eyes_m = world, p_world_eyes_m
        self._points_m = [corners[np.argsort(-corners[:, 2])[:POINTS]] for corners in vertices_m]  # the topmost ones
        self._geom = [world.model.geom(f"fragment{k}").id for k in range(len(vertices_m))]
        self._body = [world.model.body(f"fragment{k}").id for k in range(len(vertices_m))]
        self._times: list[float] = []
        self._seen: list[list[float]] = []

    def observe(self, time_s: float) -> None:
        """Check, if it is time again."""
        if len(self._eyes_m) and (not self._times or time_s - self._times[-1] > LOOK_S - 1e-9):
            self._times.append(time_s)
            self._seen.append([self._share(k) for k in range(len(self._geom))])

    def sights(self) -> Sights:
        """Return all checks so far."""
        return Sights(np.array(self._times), np.array(self._seen).reshape(len(self._times), len(self._geom)))

    def _share(self, fragment: int) -> float:
        """Return the share of a fragment's points seen by the eye that sees least, since stereo needs both."""
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
