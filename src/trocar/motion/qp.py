"""Quadratic programs, assembled from a cost and named constraints; only this module uses the solver, PIQP."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import piqp
from numpy.typing import ArrayLike
from scipy import sparse

from trocar.errors import NoPlan
from trocar.geometry.arrays import Array

FREE = 1e32  # a bound that PIQP treats as infinite


@dataclass(eq=False)
class Program:
    """A quadratic program: minimise ``x hessian x / 2 + linear x`` over x (n,), within all constraints.

    >>> program = Program("two shares", np.eye(2), np.array([-1.0, -3.0]), lower=0.0, upper=2.5)
    >>> program.least().round(3)
    array([1. , 2.5])
    """

    name: str  # for the error message
    hessian: Any  # (n, n); sparse, or dense if there are bounds of x and no rows
    linear: Array  # (n,)
    lower: ArrayLike | None = None  # of x, one or (n,); None: none
    upper: ArrayLike | None = None  # likewise
    precision: float = 1e-8  # absolute, of the solution
    relative: float = 1e-8  # the same, relative to its terms
    iterations: int = 250  # at most
    constraints: dict[str, tuple[Any, Array, Array]] = field(default_factory=dict, init=False)

    def keep(self, what: str, rows: Any, low: ArrayLike, high: ArrayLike, rest: ArrayLike = 0.0) -> None:
        """Add the constraint ``low <= rows x + rest <= high``, an equation where both bounds are equal.

        Args:
            what: the constraint's name.
            rows: (k, n), sparse.
            low: a number or (k,); ``-FREE``: no bound.
            high: a number or (k,); ``FREE``: no bound.
            rest: a number or (k,).
        """
        low, high = (np.broadcast_to(np.subtract(bound, rest), rows.shape[0]) for bound in (low, high))
        self.constraints[what] = (rows, low, high)

    def least(self) -> Array:
        """Return the solution (n,) (NoPlan: the constraints contradict each other, or the solver gives up)."""
        dense, size = isinstance(self.hessian, np.ndarray), len(self.linear)
        solver: Any = piqp.DenseSolver() if dense else piqp.SparseSolver()
        solver.settings.eps_abs, solver.settings.eps_rel = self.precision, self.relative
        solver.settings.max_iter = self.iterations
        if not dense:
            self.hessian.sort_indices()  # PIQP assumes that they are sorted, and gives wrong answers if they are not
        bounds = (None if b is None else np.broadcast_to(b, size).copy() for b in (self.lower, self.upper))
        solver.setup(np.asfortranarray(self.hessian) if dense else self.hessian, self.linear, *self._split(), *bounds)
        status = solver.solve()
        if status != piqp.PIQP_SOLVED:
            raise NoPlan(f"{self.name}: none within {', '.join(self.constraints) or 'its bounds'} (solver: {status})")
        return solver.result.x.copy()

    def _split(self) -> tuple[Any, ...]:
        """Return the equations with their right sides, and the other rows with their bounds; None: there are none."""
        if not self.constraints:
            return (None,) * 5
        parts, lows, highs = zip(*self.constraints.values(), strict=True)
        low, high = np.concatenate(lows), np.concatenate(highs)
        rows: Any = sparse.vstack(parts, format="csr")
        equal = low == high
        equations = (rows[equal].tocsc(), low[equal]) if equal.any() else (None, None)
        return *equations, *((rows[~equal].tocsc(), low[~equal], high[~equal]) if not equal.all() else (None,) * 3)
