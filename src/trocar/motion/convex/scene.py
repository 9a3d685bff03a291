"""The curve in joint space and the scene that it keeps clear of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from trocar.arms import SOLIDS, capsules
from trocar.arms.solids import MOVED, joint_axes
from trocar.geometry.capsules import cross, nearest_m
from trocar.motion.bodies import INSERTION, Bodies, MovingArm
from trocar.motion.problem import JOINTS, ArmMotion, MotionProblem
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

DEGREE = 3
SOLID_COUNT = len(SOLIDS)
TOUCHING_M = 1e-9  # segments nearer than this cross: the direction between them is their common normal
BENDING = 0.01  # weight of the squared second derivative by the share, relative to that of the squared first one


@dataclass(frozen=True, eq=False)
class Curve:
    """A clamped, evenly spaced cubic B-spline from 0 to 1, for any number of joints; control points are given later.

    Attributes:
        pieces: number of its polynomials.
    """

    pieces: int

    @property
    def controls(self) -> int:
        """Return how many control points it has; the first is its start, the last its end."""
        return self.pieces + DEGREE

    @cached_property
    def knots(self) -> Array:
        """Return where its pieces meet, (pieces + 1,) from 0 to 1."""
        return np.linspace(0.0, 1.0, self.pieces + 1)

    @cached_property
    def places(self) -> Array:
        """Return the shares (controls,) at which the control points of a straight line lie."""
        return np.lib.stride_tricks.sliding_window_view(self._padded[1:-1], DEGREE).mean(axis=1)

    @cached_property
    def energy(self) -> Array:
        """Return the matrix (controls, controls) of the energy: squared first and second derivative, integrated."""
        nodes, weights = np.polynomial.legendre.leggauss(DEGREE)
        at = ((self.knots[:-1, None] + self.knots[1:, None]) / 2 + nodes / (2 * self.pieces)).ravel()
        weight = np.tile(weights, self.pieces) / (2 * self.pieces)
        first, second = self.basis(at, 1), self.basis(at, 2)
        return (first.T * weight) @ first + BENDING * (second.T * weight) @ second

    @cached_property
    def spread(self) -> Array:
        """Return the inverse (controls, controls) of the energy of the inner control points, with 0 for both ends."""
        inverse = np.zeros_like(self.energy)
        inverse[1:-1, 1:-1] = np.linalg.inv(self.energy[1:-1, 1:-1])
        return inverse

    def basis(self, shares: Array, order: int = 0) -> Array:
        """Return the weights of the control points in a derivative by the share, at shares (k,): (k, controls)."""
        return np.asarray(self._unit(np.asarray(shares, dtype=np.float64), nu=order), dtype=np.float64)

    def inner(self, samples: int) -> Array:
        """Return shares inside the curve, this many per piece."""
        return np.linspace(0.0, 1.0, self.pieces * samples + 1)[1:-1]

    def line(self, start: Array, end: Array) -> Array:
        """Return the control points (controls, joints) of the straight line between two places (joints,)."""
        return start + self.places[:, None] * (end - start)

    def path(self, control: Array) -> Trajectory:
        """Return the path of control points (controls, joints), with the share for its time."""
        return Trajectory(self.knots, np.einsum("kpc,cj->kpj", self._taylor, control))

    @cached_property
    def _taylor(self) -> Array:
        """Return the control points' weights in the pieces' coefficients, (4, pieces, controls), highest first."""
        orders = range(DEGREE, -1, -1)
        inside = (self.knots[:-1] + self.knots[1:]) / 2
        third = self.basis(inside, DEGREE)  # it jumps at the knots
        values = [third] + [self.basis(self.knots[:-1], order) for order in orders if order < DEGREE]
        return np.stack([value / factorial(order) for value, order in zip(values, orders, strict=True)])

    @cached_property
    def _padded(self) -> Array:
        return np.concatenate([np.zeros(DEGREE), self.knots, np.ones(DEGREE)])

    @cached_property
    def _unit(self) -> BSpline:
        return BSpline(self._padded, np.eye(self.controls), DEGREE)


curve_of = lru_cache(maxsize=16)(Curve)


@dataclass(frozen=True, eq=False)
class Scene:
    """The planned arms, the other arms, obstacles, and which pairs of their capsules are considered.

    Attributes:
        arms: the planned ones, in order; their joints are concatenated.
        bodies: all capsules, numbered; those of the planned arms come first.
        pairs: (pairs, 2) indices of bodies; the first belongs to a planned arm.
    """

    arms: tuple[ArmMotion, ...]
    bodies: Bodies
    pairs: NDArray[np.intp]

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
    """Distances of the pairs of a scene at n places of a path.

    Attributes:
        scene: whose pairs.
        q: (n, joints).
        ends_m: (n, bodies, 2, 3).
        gaps_m: (n, pairs, 3) shortest vectors, from the second to the first capsule's axis.
        along: (n, pairs) shares of the first capsule's axis where they end.
        distance_m: (n, pairs) signed.
    """

    scene: Scene
    q: Array
    ends_m: Array
    gaps_m: Array
    along: Array
    distance_m: Array

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
    """The joints of one arm at n places, in the world: the velocity that each gives a point of the instrument.

    Attributes:
        turning: (n, 6, 3) axes of the revolute joints; 0 for the prismatic one.
        sliding: (n, 6, 3) velocity that each gives the world's origin.
    """

    turning: Array
    sliding: Array

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
