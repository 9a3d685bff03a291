"""The scene that paths keep clear of: distances of its capsules, and their gradients by the joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, capsules
from trocar.arms.solids import MOVED, joint_axes
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import cross, nearest_m
from trocar.motion.bodies import INSERTION, Bodies, MovingArm
from trocar.motion.problem import JOINTS, ArmMotion, MotionProblem
from trocar.trajectory import Trajectory

SOLID_COUNT = len(SOLIDS)
TOUCHING_M = 1e-9  # segments nearer than this count as crossing: their common normal is used as direction


@dataclass(frozen=True, eq=False)
class Scene:
    """The planned arms, the other arms, obstacles, and which pairs of their capsules are considered."""

    arms: tuple[ArmMotion, ...]  # the planned ones, in order; their joints are concatenated
    bodies: Bodies  # all capsules, numbered; those of the planned arms come first
    pairs: NDArray[np.intp]  # (pairs, 2) indices of bodies; the first belongs to a planned arm

    @classmethod
    def of(cls, problem: MotionProblem) -> Scene:
        """Return the scene of a problem, with all pairs."""
        still = {
            name: MovingArm.resting(arm.model, arm.waypoints[0], arm.T_world_base, arm.jaw_rad)
            for name, arm in problem.arms.items()
        }
        bodies = Bodies.of(still, problem.others, problem.obstacles)
        return cls(tuple(problem.arms.values()), bodies, bodies.pairs)

    def looking_at(self, which: NDArray[np.bool_]) -> Scene:
        """Return the scene with some of its pairs only."""
        return replace(self, pairs=self.pairs[which])

    def everything(self) -> Scene:
        """Return the scene with all pairs."""
        return replace(self, pairs=self.bodies.pairs)

    @property
    def timed(self) -> bool:
        """Return whether another arm moves, so that the time of passing a place matters."""
        others = self.bodies.movers[len(self.arms) :]
        return any(len(arm.trajectory.coefficients) > 1 and arm.end_s > 0 for arm in others)

    def ends_m(self, q: Array, t_s: Array) -> Array:
        """Return both ends of all capsules (n, bodies, 2, 3) in the world at joints (n, joints) and times (n,)."""
        parts = []
        for k, arm in enumerate(self.arms):
            local = capsules(arm.model, q[:, columns_of(k)], arm.jaw_rad)
            parts.append(local.moved(arm.T_world_base).ends_m)
        parts += [arm.ends_m(t_s) for arm in self.bodies.movers[len(self.arms) :]]
        still = self.bodies.still.ends_m
        return np.concatenate([*parts, np.broadcast_to(still, (len(q), *still.shape))], axis=1)

    def distances(self, q: Array, t_s: Array) -> Distances:
        """Return the distances of the pairs at joints (n, joints) and times (n,)."""
        ends = self.ends_m(q, t_s)
        a, b = self.pairs.T
        p, r = ends[:, a], ends[:, b]
        gaps, along, _ = nearest_m(p[..., 0, :], p[..., 1, :], r[..., 0, :], r[..., 1, :])
        lengths = np.sqrt(np.einsum("...i,...i->...", gaps, gaps))
        radii = self.bodies.radii_m
        return Distances(self, q, ends, gaps, along, lengths - radii[a] - radii[b])


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of the pairs of a scene at n places of a path."""

    scene: Scene  # whose pairs
    q: Array  # (n, joints)
    ends_m: Array  # (n, bodies, 2, 3)
    gaps_m: Array  # (n, pairs, 3) shortest vectors, from the second to the first capsule's axis
    along: Array  # (n, pairs) shares of the first capsule's axis where they end
    distance_m: Array  # (n, pairs) signed

    def gradients(self, place: NDArray[np.intp], pair: NDArray[np.intp]) -> Array:
        """Return the gradients (rows, joints) by the joints of the distances of pairs at places, (rows,) each."""
        first, second = self.scene.pairs[pair].T
        p, r, gap = self.ends_m[place, first], self.ends_m[place, second], self.gaps_m[place, pair]
        length = np.sqrt(np.einsum("ri,ri->r", gap, gap))
        way = gap / np.where(length > TOUCHING_M, length, 1.0)[:, None]
        crossing = length <= TOUCHING_M
        if crossing.any():
            normal = cross(p[crossing, 1] - p[crossing, 0], r[crossing, 1] - r[crossing, 0])
            way[crossing] = normal / np.maximum(np.linalg.norm(normal, axis=1), TOUCHING_M)[:, None]
        on_first = p[:, 0] + self.along[place, pair, None] * (p[:, 1] - p[:, 0])
        slopes = np.zeros((len(place), self.q.shape[1]))
        for bodies, points, ways in ((first, on_first, way), (second, on_first - gap, -way)):
            for k, joints in enumerate(self.screws):
                rows = np.flatnonzero(bodies // SOLID_COUNT == k)
                if len(rows):
                    moved = MOVED[bodies[rows] % SOLID_COUNT]
                    part = joints.slopes(place[rows], points[rows], ways[rows]) * moved
                    slopes[rows, columns_of(k)] = part
        return slopes

    @cached_property
    def screws(self) -> tuple[Screws, ...]:
        """Return the joint axes of every planned arm at all places."""
        arms = enumerate(self.scene.arms)
        return tuple(Screws.of(arm, self.q[:, columns_of(k)]) for k, arm in arms)


@dataclass(frozen=True, eq=False)
class Screws:
    """The joints of one arm at n places, in the world: the velocity that each gives a point of the instrument."""

    turning: Array  # (n, 6, 3) axes of the revolute joints; 0 for the prismatic one
    sliding: Array  # (n, 6, 3) velocity that each gives the world's origin

    @classmethod
    def of(cls, arm: ArmMotion, q: Array) -> Screws:
        """Return the axes at joints (n, 6)."""
        axes, origins = joint_axes(arm.model, q)
        R, t = arm.T_world_base.matrix[:3, :3], arm.T_world_base.matrix[:3, 3]
        axes, origins = axes @ R.T, origins @ R.T + t
        sliding = cross(origins, axes)
        sliding[:, INSERTION] = axes[:, INSERTION]
        axes[:, INSERTION] = 0.0
        return cls(axes, sliding)

    def slopes(self, place: NDArray[np.intp], points_m: Array, ways: Array) -> Array:
        """Return the speeds of points (rows, 3) along directions (rows, 3) due to each joint, at places: (rows, 6)."""
        moments = cross(points_m, ways)
        turned = np.einsum("rji,ri->rj", self.turning[place], moments)
        return turned + np.einsum("rji,ri->rj", self.sliding[place], ways)


def columns_of(k: int) -> slice:
    """Return where the joints of arm k are among those of all arms."""
    return slice(JOINTS * k, JOINTS * (k + 1))


def joint_path(path: Trajectory, k: int) -> Trajectory:
    """Return the path of one arm's joints from that of all."""
    return Trajectory(path.times_s, path.coefficients[:, :, columns_of(k)])
