"""Quadratic programmes over splines of the joints: limits and the tip's way as linear rows, solved by PIQP."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import factorial

import numpy as np
import piqp
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import BSpline

from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

FREE = 1e32
"""A bound that PIQP takes for none."""
PRECISION = 1e-7
"""Of its answer; the times are taken from the splines themselves, exactly."""


@dataclass(frozen=True, eq=False)
class Basis:
    """Weights (k, degree + 1) of control points, and which ones (k, degree + 1) they are."""

    weights: Array
    columns: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of a matrix: their entries (entries,) with row and column, and what is added to each row (rows,)."""

    data: Array
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    rest: Array

    def __neg__(self) -> Block:
        """Return the negative rows."""
        return Block(-self.data, self.row, self.column, -self.rest)


@dataclass(frozen=True, eq=False)
class JointSpline:
    """All joints' clamped B-spline over the share of the time, from rest to rest; some of its control points are free.

    Attributes:
        shares: (n + 1,) knots from 0 to 1.
        degree: 2: the acceleration is constant between knots; 3: linear.
        begin: (joints,) where it rests.
        end: (joints,) where it comes to rest.
        held: control points at each end that are there: 2 to rest, 3 to start without acceleration too.
    """

    shares: Array
    degree: int
    begin: Array
    end: Array
    held: int = 2

    def basis(self, shares: Array, order: int = 0) -> Basis:
        """Return what the control points weigh in a derivative by the share at shares (k,)."""
        dense = self._unit(shares, nu=order)
        piece = np.clip(np.searchsorted(self.shares, shares, side="right") - 1, 0, len(self.shares) - 2)
        columns = piece[:, None] + np.arange(self.degree + 1)
        return Basis(np.take_along_axis(dense, columns, axis=1), columns)

    def rows(self, basis: Basis, gradient: Array) -> Block:
        """Return the rows ``gradient (k, joints) . q`` of the free control points, joint by joint, of a basis of k."""
        free, joints = self.free, len(self.begin)
        held = (basis.columns < self.held) | (basis.columns >= self.held + free)
        ends = np.where(basis.columns[..., None] < self.held, self.begin, self.end)
        rest = np.einsum("kj,kp,kpj->k", gradient, np.where(held, basis.weights, 0.0), ends)
        data = gradient[:, :, None] * basis.weights[:, None, :]
        columns = np.arange(joints)[:, None] * free + (basis.columns - self.held)[:, None, :]
        row = np.broadcast_to(np.arange(len(data))[:, None, None], data.shape)
        there = np.broadcast_to(~held[:, None, :], data.shape) & (data != 0.0)
        return Block(data[there], row[there], columns[there], rest)

    def each_joint(self, basis: Basis, scale: Array) -> Block:
        """Return the rows of every joint alone (joints * k), joint by joint, divided by ``scale (joints,)``."""
        repeated = Basis(np.tile(basis.weights, (len(scale), 1)), np.tile(basis.columns, (len(scale), 1)))
        return self.rows(repeated, np.repeat(np.diag(1 / scale), len(basis.weights), axis=0))

    @property
    def free(self) -> int:
        """Return how many control points of a joint are free."""
        return len(self.shares) - 1 + self.degree - 2 * self.held

    def control(self, free: Array) -> Array:
        """Return all control points (.., joints) from the free ones, joint by joint."""
        inner = free.reshape(len(self.begin), -1).T
        first, last = (np.repeat(q[None], self.held, axis=0) for q in (self.begin, self.end))
        return np.concatenate([first, inner, last])

    def trajectory(self, control: Array, seconds: float) -> Trajectory:
        """Return the motion that takes this time."""
        curve = BSpline(self._knots, control, self.degree)
        orders = range(self.degree, -1, -1)
        parts = [curve(self.shares[:-1], nu=order) / factorial(order) / seconds**order for order in orders]
        return Trajectory(seconds * self.shares, np.stack(parts))

    @cached_property
    def _knots(self) -> Array:
        return np.concatenate([np.zeros(self.degree), self.shares, np.ones(self.degree)])

    @cached_property
    def _unit(self) -> BSpline:
        return BSpline(self._knots, np.eye(len(self.shares) - 1 + self.degree), self.degree)


@dataclass
class Rows:
    """Linear inequalities ``low <= G x <= high``, gathered block by block.

    x are the free control points and, after them, ``extras`` other variables.
    """

    free: int
    extras: int
    blocks: list[Block] = field(default_factory=list)
    lows: list[Array] = field(default_factory=list)
    highs: list[Array] = field(default_factory=list)

    def add(self, block: Block, low: Array | float, high: Array | float, extra: int = 0, weight: float = 0.0) -> None:
        """Bound ``block x + rest + weight * extra variable``.

        Args:
            block: rows of the free control points.
            low: (rows,) or of all.
            high: (rows,) or of all.
            extra: index of the other variable.
            weight: 0: none.
        """
        count, shift = len(block.rest), sum(map(len, self.lows))
        data, row, column = [block.data], [block.row], [block.column]
        if weight:
            data.append(np.full(count, weight))
            row.append(np.arange(count))
            column.append(np.full(count, self.free + extra))
        self.blocks.append(Block(*map(np.concatenate, (data, row, column)), block.rest))  # type: ignore[arg-type]
        self.blocks[-1].row[:] += shift
        self.lows.append(low - block.rest)
        self.highs.append(high - block.rest)

    def least(self, hessian: sparse.csc_matrix, cost: Array) -> Array | None:
        """Return the x (m,) that makes ``x H x / 2 + cost x`` least; None where none was found."""
        data, row, column = (
            np.concatenate([getattr(block, name) for block in self.blocks]) for name in ("data", "row", "column")
        )
        low, high = np.concatenate(self.lows), np.concatenate(self.highs)
        matrix = sparse.csc_matrix((data, (row, column)), shape=(len(low), self.free + self.extras))
        solver = piqp.SparseSolver()
        solver.settings.eps_abs = PRECISION
        solver.settings.eps_rel = PRECISION
        solver.setup(hessian, cost, None, None, matrix, low, high)
        return solver.result.x.copy() if solver.solve() == piqp.PIQP_SOLVED else None
