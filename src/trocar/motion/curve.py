"""Cubic B-splines of the joints over the share of a path or of a motion's time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import factorial

import numpy as np
from scipy.interpolate import BSpline

from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory

DEGREE = 3
BENDING = 0.01  # weight of the squared second derivative by the share, relative to that of the squared first one


@dataclass(frozen=True, eq=False)
class Curve:
    """A clamped cubic B-spline from 0 to 1, for any number of joints; control points are given later."""

    knots: Array  # (pieces + 1,) where its polynomials meet, from 0 to 1

    @staticmethod
    @lru_cache(maxsize=16)
    def even(pieces: int) -> Curve:
        """Return the curve with knots at even steps; cached, together with its matrices."""
        return Curve(np.linspace(0.0, 1.0, pieces + 1))

    @property
    def pieces(self) -> int:
        """Return the number of its polynomials."""
        return len(self.knots) - 1

    @property
    def controls(self) -> int:
        """Return how many control points it has; the first is its start, the last its end."""
        return self.pieces + DEGREE

    @cached_property
    def places(self) -> Array:
        """Return the shares (controls,) at which the control points of a straight line lie."""
        return np.lib.stride_tricks.sliding_window_view(self.padded[1:-1], DEGREE).mean(axis=1)

    @cached_property
    def energy(self) -> Array:
        """Return the matrix (controls, controls) of the energy of an even curve.

        It integrates the squared first derivative and, with the weight ``BENDING``, the squared second one.
        """
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
    def padded(self) -> Array:
        """Return its knots, those at both ends repeated."""
        return np.concatenate([np.zeros(DEGREE), self.knots, np.ones(DEGREE)])

    @cached_property
    def _unit(self) -> BSpline:
        return BSpline(self.padded, np.eye(self.controls), DEGREE)
