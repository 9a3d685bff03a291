"""Quadratic programs over joint splines: limits and the tip's path as linear rows, solved by PIQP."""

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
"""A bound that PIQP treats as infinite."""
ITERATIONS = 60
"""Maximum number of iterations; a solution takes 15 to 30."""
PRECISION = 1e-7
"""Precision of its solution; the times are computed exactly from the splines themselves."""


@dataclass(frozen=True, eq=False)
class Basis:
    """Weights (k, degree + 1) of control points, and which ones (k, degree + 1) they are."""

    weights: Array
    columns: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of a matrix: their entries (entries,) with row and column, and a constant per row (rows,)."""

    data: Array
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    rest: Array

    def matrix(self, columns: int) -> sparse.csr_matrix:
        """Return the rows as a matrix (rows, columns)."""
        return sparse.csr_matrix((self.data, (self.row, self.column)), shape=(len(self.rest), columns))

    def __neg__(self) -> Block:
        """Return the negative rows."""
        return Block(-self.data, self.row, self.column, -self.rest)


@dataclass(frozen=True, eq=False)
class JointSpline:
    """All joints' clamped B-spline over the share of the time; the control points between its ends are free.

    Attributes:
        shares: (n + 1,) knots from 0 to 1.
        degree: 2: the acceleration is constant between knots; 3: linear.
        first: (a, joints) control points at its start: two at one place for rest, three to accelerate from 0 as well.
        last: (b, joints) those at its end.
    """

    shares: Array
    degree: int
    first: Array
    last: Array

    def basis(self, shares: Array, order: int = 0) -> Basis:
        """Return the weights of the control points in a derivative by the share at shares (k,)."""
        dense = self._unit(shares, nu=order)
        piece = np.clip(np.searchsorted(self.shares, shares, side="right") - 1, 0, len(self.shares) - 2)
        columns = piece[:, None] + np.arange(self.degree + 1)
        return Basis(np.take_along_axis(dense, columns, axis=1), columns)

    def rows(self, basis: Basis, gradient: Array) -> Block:
        """Return the rows ``gradient (k, joints) . q`` of the free control points, joint by joint, of a basis of k.

        A free control point is given relative to the straight line between both ends, to avoid subtracting large
        numbers.
        """
        free, before = self.free, len(self.first)
        held = (basis.columns < before) | (basis.columns >= before + free)
        rest = np.einsum("kj,kp,kpj->k", gradient, basis.weights, self._line[basis.columns])
        data = gradient[:, :, None] * basis.weights[:, None, :]
        columns = np.arange(gradient.shape[1])[:, None] * free + (basis.columns - before)[:, None, :]
        row = np.broadcast_to(np.arange(len(data))[:, None, None], data.shape)
        there = np.broadcast_to(~held[:, None, :], data.shape) & (data != 0.0)
        return Block(data[there], row[there], columns[there], rest)

    def each_joint(self, basis: Basis, scale: Array) -> Block:
        """Return the rows of each joint by itself (joints * k), joint by joint, divided by ``scale (joints,)``."""
        repeated = Basis(np.tile(basis.weights, (len(scale), 1)), np.tile(basis.columns, (len(scale), 1)))
        return self.rows(repeated, np.repeat(np.diag(1 / scale), len(basis.weights), axis=0))

    @property
    def free(self) -> int:
        """Return how many control points of a joint are free."""
        return len(self.shares) - 1 + self.degree - len(self.first) - len(self.last)

    def control(self, free: Array) -> Array:
        """Return all control points (.., joints) from the free ones' offsets from the line, joint by joint."""
        control = self._line.copy()
        control[len(self.first) : -len(self.last)] += free.reshape(self.first.shape[1], -1).T
        return control

    def trajectory(self, control: Array, seconds: float) -> Trajectory:
        """Return the motion that takes this time."""
        curve = BSpline(self._knots, control, self.degree)
        orders = range(self.degree, -1, -1)
        parts = [curve(self.shares[:-1], nu=order) / factorial(order) / seconds**order for order in orders]
        return Trajectory(seconds * self.shares, np.stack(parts))

    @cached_property
    def _line(self) -> Array:
        """Return the control points of a straight line between the ends, to which the free ones are relative."""
        at = np.lib.stride_tricks.sliding_window_view(self._knots[1:-1], self.degree).mean(axis=1)[:, None]
        line = (1 - at) * self.first[0] + at * self.last[-1]
        line[: len(self.first)], line[-len(self.last) :] = self.first, self.last
        return line

    @cached_property
    def _knots(self) -> Array:
        return np.concatenate([np.zeros(self.degree), self.shares, np.ones(self.degree)])

    @cached_property
    def _unit(self) -> BSpline:
        return BSpline(self._knots, np.eye(len(self.shares) - 1 + self.degree), self.degree)


@dataclass
class Rows:
    """Linear inequalities ``low <= G x <= high``, gathered block by block; an equation if both are the same.

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
        """Return the x (m,) that minimises ``x H x / 2 + cost x``; None if none was found."""
        data, row, column = (
            np.concatenate([getattr(block, name) for block in self.blocks]) for name in ("data", "row", "column")
        )
        low, high = np.concatenate(self.lows), np.concatenate(self.highs)
        matrix = sparse.csr_matrix((data, (row, column)), shape=(len(low), self.free + self.extras))
        equal, bounded = low == high, low < high
        equations = (matrix[equal].tocsc(), low[equal]) if equal.any() else (None, None)
        hessian.sort_indices()  # PIQP assumes that they are sorted, and gives wrong answers if they are not
        solver = piqp.SparseSolver()
        solver.settings.eps_abs = PRECISION
        solver.settings.eps_rel = PRECISION
        solver.settings.max_iter = ITERATIONS
        solver.setup(hessian, cost, *equations, matrix[bounded].tocsc(), low[bounded], high[bounded])
        return solver.result.x.copy() if solver.solve() == piqp.PIQP_SOLVED else None
