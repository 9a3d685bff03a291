"""One convex program: the least energy with an l1 penalty on violated rows, solved in its dual variables."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import piqp
from numpy.typing import NDArray

from trocar.motion.arm_motion import JOINTS
from trocar.motion.convex.curve import Curve
from trocar.motion.convex.rows import Rows

Array = NDArray[np.float64]

ROUNDS = 4
"""Maximum number of times that rows violated by the answer are added to the program."""
ADDED = 40
"""Maximum number of rows added at a time, the most violated first."""
KEPT_M = 1e-6
"""A row counts as violated below minus this."""
PRECISION = 1e-8


@dataclass(frozen=True, eq=False)
class Programme:
    """The energy of a path, and the changes of its control points that are free.

    Attributes:
        curve: of the path.
        weights: (joints,) of the squared joints in the energy.
        held: for each arm the basis (waypoints, controls) of its inner waypoints, which must stay.
        known: inverses by damping, cached because the next step often needs the same.
    """

    curve: Curve
    weights: Array
    held: tuple[Array, ...]
    known: dict[float, list[Array]] = field(default_factory=dict, repr=False)

    def energy(self, control: Array) -> float:
        """Return the energy of a path of control points (controls, joints)."""
        return float(np.einsum("cj,cd,dj,j->", control, self.curve.energy, control, self.weights)) / 2

    def inverses(self, damping: float) -> list[Array]:
        """Return for each arm the inverse (controls, controls) of energy and damping on the changes that are free."""
        if damping not in self.known:
            self.known[damping] = self._inverses(damping)
        return self.known[damping]

    def _inverses(self, damping: float) -> list[Array]:
        inner, count = slice(1, -1), self.curve.controls
        matrix = self.curve.energy[inner, inner] + damping * np.eye(count - 2) / count
        plain = np.linalg.inv(matrix)
        found = []
        for held in self.held:
            inverse = np.zeros((count, count))
            kept = plain
            if len(held):
                across = plain @ held[:, inner].T
                kept = plain - across @ np.linalg.solve(held[:, inner] @ across, across.T)
            inverse[inner, inner] = kept
            found.append(inverse)
        return found

    def step(self, control: Array, rows: Rows, price: float, damping: float) -> Array:
        """Return the change (controls, joints) of the control points that solves the program.

        It minimises ``energy + damping |dx|^2 / 2 + price * sum of violations``. Its dual has one variable per row,
        between 0 and ``price``; a row that is not violated costs nothing and is left out until it is.

        Args:
            control: (controls, joints) about which the rows are linear.
            rows: to be kept.
            price: of a row that is violated by one metre.
            damping: the trust region: the greater, the smaller the step.
        """
        inverses = self.inverses(damping)
        pull = self.curve.energy @ control
        change = np.empty_like(control)
        for k, inverse in enumerate(inverses):
            columns = slice(JOINTS * k, JOINTS * (k + 1))
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
        """Return by how much the prices of rows shift the control points from where they would be without rows."""
        basis, slope = rows.basis[which], rows.slope[which]
        gram = np.zeros((len(which), len(which)))
        for k, inverse in enumerate(inverses):
            columns = slice(JOINTS * k, JOINTS * (k + 1))
            gram += (basis @ inverse @ basis.T) * ((slope[:, columns] / self.weights[columns]) @ slope[:, columns].T)
        missing = -(rows.room[which] + np.einsum("rj,rj->r", slope, basis @ free))
        prices = _bounded_least(gram, missing, price)
        push = basis.T @ (prices[:, None] * slope / self.weights)
        for k, inverse in enumerate(inverses):
            columns = slice(JOINTS * k, JOINTS * (k + 1))
            push[:, columns] = inverse @ push[:, columns]
        return push


def _bounded_least(gram: Array, missing: Array, price: float) -> Array:
    """Return the prices (rows,), between 0 and the greatest, that minimise ``x gram x / 2 - missing x``."""
    count = len(missing)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-12))
    matrix = gram / scale / scale[:, None] + 1e-9 * np.eye(count)
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = PRECISION
    top = float(np.abs(missing / scale).max())
    solver.setup(np.asfortranarray(matrix), -missing / scale / top, x_l=np.zeros(count), x_u=price * scale / top)
    solver.solve()
    return np.clip(top * solver.result.x / scale, 0.0, price)
