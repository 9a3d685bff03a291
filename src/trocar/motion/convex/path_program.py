"""The convex program in the control points of a curve: its rows, its solution, and what is checked in the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import cross
from trocar.motion.convex.scene import Distances, columns_of
from trocar.motion.curve import Curve
from trocar.motion.problem import ArmMotion
from trocar.motion.qp import Program

FACING_M = 0.05  # weight of an angle's cosine relative to distances: the displacement of a mark this far from the tip
FACED = 0.3  # a facing constraint counts if its cosine is within this of the limit
INSIDE = 5e-4  # margin (rad, m) of the control points to the ends of the joints' ranges
RANGE_M = 0.1  # weight of a joint outside its range (rad, m) relative to distances
ROUNDS = 4  # maximum number of times that rows violated by the answer are added to the program
ADDED = 40  # maximum number of rows added at a time, the most violated first
KEPT_M = 1e-6  # a row counts as violated below minus this


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``room + slope . (basis dx)``, each to be at least 0; dx (controls, joints) moves the control points."""

    room: Array  # (rows,) what is left now, m; below 0 where a row is violated
    slope: Array  # (rows, joints) by the joints
    basis: Array  # (rows, controls) of the control points

    @staticmethod
    def joined(parts: list[Rows]) -> Rows:
        """Return the rows of all parts."""
        room, slope, basis = zip(*((part.room, part.slope, part.basis) for part in parts), strict=True)
        return Rows(np.concatenate(room), np.concatenate(slope), np.concatenate(basis))

    def after(self, change: Array) -> Array:
        """Return what is left of the rows (rows,) if the control points move by (controls, joints)."""
        return self.room + np.einsum("rj,rj->r", self.slope, self.basis @ change)


def distance_rows(distances: Distances, wanted_m: Array, basis: Array, watched_m: float) -> Rows:
    """Return the rows of all pairs closer than ``wanted_m`` (n,) plus ``watched_m`` at n places."""
    room = distances.distance_m - wanted_m[:, None]
    place, pair = np.nonzero(room < watched_m)
    return Rows(room[place, pair], distances.gradients(place, pair), basis[place])


def range_rows(arms: tuple[ArmMotion, ...], control: Array, slack: float) -> Rows:
    """Return the rows of control points (controls, joints) near the end of a joint's range or beyond it.

    The path lies within the hull of its control points, separately for each joint.
    """
    lower, upper = (np.concatenate([getattr(arm.model, name) for arm in arms]) for name in ("lower", "upper"))
    extent = upper - lower
    inside = INSIDE - slack * extent
    rooms = np.stack([control - lower - inside, upper - inside - control])
    rooms[:, [0, -1]] = np.inf
    side, row, joint = np.nonzero(rooms < 0.1 * extent)
    slope = np.zeros((len(row), control.shape[1]))
    slope[np.arange(len(row)), joint] = RANGE_M * np.where(side == 0, 1.0, -1.0)
    return Rows(RANGE_M * rooms[side, row, joint], slope, np.eye(len(control))[row])


def facing_rows(distances: Distances, spare_rad: Array, basis: Array) -> Rows:
    """Return the rows of the facing constraints, with a margin (n,) at n places, that are violated or nearly so."""
    joints = distances.q.shape[1]
    parts = [Rows(np.zeros(0), np.zeros((0, joints)), np.zeros((0, basis.shape[1])))]
    for k, arm in enumerate(distances.scene.arms):
        if arm.facing is None:
            continue
        columns = columns_of(k)
        T_world_tip = arm.T_world_base @ fk(arm.model, distances.q[:, columns])
        axis, tip = T_world_tip.matrix[:, :3, :3] @ arm.facing.axis, T_world_tip.matrix[:, :3, 3]
        way = arm.facing.towards_m - tip
        away = np.sqrt(np.einsum("ni,ni->n", way, way))[:, None]
        way /= away
        cosines = np.einsum("ni,ni->n", axis, way)
        room = FACING_M * (cosines - np.cos(np.maximum(arm.facing.max_rad - spare_rad, 1e-3)))
        near = np.flatnonzero(room < FACING_M * FACED)
        if not len(near):
            continue
        axis, way = axis[near], way[near]
        screws = distances.screws[k]
        swing = np.einsum("rji,ri->rj", screws.turning[near], cross(axis, way))
        aside = (cosines[near, None] * way - axis) / away[near]
        slopes = np.zeros((len(near), joints))
        slopes[:, columns] = FACING_M * (swing + screws.slopes(near, tip[near], aside))
        parts.append(Rows(room[near], slopes, basis[near]))
    return Rows.joined(parts)


def taper(shares: Array, margin: float) -> Array:
    """Return a margin (n,) that grows from 0 at both ends of the path: a start may be just at the allowed distance."""
    return margin * np.clip(np.minimum(shares, 1 - shares) / 0.1, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class PathProgram:
    """The energy of a path, and the program for the change of its free control points."""

    curve: Curve  # of the path
    weights: Array  # (joints,) of the squared joints in the energy
    held: tuple[Array, ...]  # for each arm the basis (waypoints, controls) of its inner waypoints, which must stay
    # inverses by damping, cached because the next step often needs the same
    known: dict[float, list[Array]] = field(default_factory=dict, repr=False)

    def energy(self, control: Array) -> float:
        """Return the energy of a path of control points (controls, joints)."""
        return float(np.einsum("cj,cd,dj,j->", control, self.curve.energy, control, self.weights)) / 2

    def inverses(self, damping: float) -> list[Array]:
        """Return for each arm the inverse (controls, controls) of energy and damping on the changes that are free."""
        if damping in self.known:
            return self.known[damping]
        inner, count = slice(1, -1), self.curve.controls
        plain = np.linalg.inv(self.curve.energy[inner, inner] + damping * np.eye(count - 2) / count)
        found = [np.zeros((count, count)) for _ in self.held]
        for inverse, held in zip(found, self.held, strict=True):
            inverse[inner, inner] = plain
            if len(held):
                across = plain @ held[:, inner].T
                inverse[inner, inner] = plain - across @ np.linalg.solve(held[:, inner] @ across, across.T)
        self.known[damping] = found
        return found

    def step(self, control: Array, rows: Rows, price: float, damping: float) -> Array:
        """Return the change (controls, joints) of the control points that solves the program.

        It minimises ``energy + damping |dx|^2 / 2 + price * sum of violations``. The dual is solved: it has one
        variable per row, between 0 and ``price`` (the penalty per metre). Rows are added only once they are violated.
        The damping acts as a trust region: the greater it is, the smaller the step.
        """
        inverses = self.inverses(damping)
        pull = self.curve.energy @ control
        change = np.empty_like(control)
        for k, inverse in enumerate(inverses):
            columns = columns_of(k)
            change[:, columns] = -inverse @ pull[:, columns]
        free = change
        used = np.zeros(len(rows.room), dtype=bool)
        for _ in range(ROUNDS):
            left = np.where(used, 0.0, rows.after(change))
            worst = np.argsort(left)[:ADDED]
            worst = worst[left[worst] < -KEPT_M]
            if not len(worst):
                break
            used[worst] = True
            change = free + self._pushed(rows, np.flatnonzero(used), free, inverses, price)
        return change

    def _pushed(self, rows: Rows, which: NDArray[np.intp], free: Array, inverses: list[Array], price: float) -> Array:
        """Return how far the rows ``which`` shift the control points from the solution ``free`` without rows."""
        basis, slope = rows.basis[which], rows.slope[which]
        gram = np.zeros((len(which), len(which)))
        for k, inverse in enumerate(inverses):
            columns = columns_of(k)
            gram += (basis @ inverse @ basis.T) * ((slope[:, columns] / self.weights[columns]) @ slope[:, columns].T)
        missing = -(rows.room[which] + np.einsum("rj,rj->r", slope, basis @ free))
        prices = _bounded_least(gram, missing, price)
        push = basis.T @ (prices[:, None] * slope / self.weights)
        for k, inverse in enumerate(inverses):
            columns = columns_of(k)
            push[:, columns] = inverse @ push[:, columns]
        return push


def _bounded_least(gram: Array, missing: Array, price: float) -> Array:
    """Return the prices x (rows,), between 0 and ``price``, that minimise ``x gram x / 2 - missing x``."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-12))
    matrix = gram / scale / scale[:, None] + 1e-9 * np.eye(len(missing))
    top = float(np.abs(missing / scale).max())
    prices = Program("prices of violated rows", matrix, -missing / scale / top, lower=0.0, upper=price * scale / top)
    return np.clip(top * prices.least() / scale, 0.0, price)


def in_range(arms: tuple[ArmMotion, ...], q: Array, slack: float) -> bool:
    """Return whether joints keep their ranges at evenly spaced places q (n, joints), and on parabolas in between."""
    for k, arm in enumerate(arms):
        part = q[:, columns_of(k)]
        beyond = slack * (arm.model.upper - arm.model.lower) - np.abs(np.diff(part, n=2, axis=0)).max(axis=0) / 8
        if np.any(part.min(axis=0) < arm.model.lower - beyond) or np.any(part.max(axis=0) > arm.model.upper + beyond):
            return False
    return True


def faces(arms: tuple[ArmMotion, ...], q: Array) -> bool:
    """Return whether the tips face their points at evenly spaced places q (n, joints), and on parabolas in between.

    The first and the last place are given, so they are not checked here.
    """
    for k, arm in enumerate(arms):
        if arm.facing is None:
            continue
        angles = arm.facing.angle_rad(arm.T_world_base @ fk(arm.model, q[:, columns_of(k)]))
        if angles[1:-1].max() + np.abs(np.diff(angles, n=2)).max() / 8 > arm.facing.max_rad:
            return False
    return True
