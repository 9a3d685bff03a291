"""Starts of the search: the plain path, and detours on which one arm or both pull back or swing aside, or one waits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.motion.arm_motion import JOINTS, ArmMotion
from trocar.motion.convex.curve import Curve
from trocar.motion.convex.programme import Programme

Array = NDArray[np.float64]

FEW = ((0.0, 0.0, 0.03), (0.0, 0.0, 0.06), (0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, -0.2, 0.0))
"""Detours that are tried first: offsets of the first two joints (rad), and how far the instrument is pulled back
(m)."""
MORE = tuple((a, b, c) for c in (0.0, 0.04, 0.08) for a in (-0.4, 0.0, 0.4) for b in (-0.4, 0.0, 0.4) if a or b or c)
"""Detours that are tried next."""


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts for one problem.

    Attributes:
        arms: in order.
        programme: of the curve and what is held fixed.
        plain: (controls, joints) the path of least energy through all waypoints.
        slack: share of the joints' ranges by which they may be left.
    """

    arms: tuple[ArmMotion, ...]
    programme: Programme
    plain: Array
    slack: float

    def few(self) -> Array:
        """Return the most promising detours (k, controls, joints)."""
        found = []
        for asides in self._combined(FEW[:2]):
            found.append(self._aside(asides))
        for k, way in product(range(len(self.arms)), FEW[2:]):
            found.append(self._aside({k: way}))
        for first in range(len(self.arms) if len(self.arms) > 1 else 0):
            found.append(self._one_after_the_other(first, {}))
            for k in range(len(self.arms)):
                found.append(self._one_after_the_other(first, {k: FEW[0]}))
        return self._kept(found)

    def many(self) -> Iterator[Array]:
        """Yield batches (k, controls, joints) of all others."""
        found = [self._aside({k: way}) for k, way in product(range(len(self.arms)), MORE)]
        yield self._kept(found)
        if len(self.arms) > 1:
            for first in range(len(self.arms)):
                found = [self._one_after_the_other(first, {k: w}) for k, w in product(range(len(self.arms)), MORE)]
                yield self._kept(found)
            pairs = product(MORE[::3], MORE[1::3])
            yield self._kept([self._aside({0: a, 1: b}) for a, b in pairs])

    def _combined(self, ways: tuple[tuple[float, float, float], ...]) -> Iterator[dict[int, tuple]]:
        for way in ways:
            if len(self.arms) > 1:
                yield {k: way for k in range(len(self.arms))}
            for k in range(len(self.arms)):
                yield {k: way}

    def _aside(self, ways: dict[int, tuple]) -> Array:
        """Return the plain path with some arms (by index) swung aside in the middle."""
        control = self.plain.copy()
        bump = np.sin(np.pi * self.programme.curve.places) ** 0.7
        for k, (first, second, back_m) in ways.items():
            control[:, JOINTS * k] += first * bump
            control[:, JOINTS * k + 1] += second * bump
            control[:, JOINTS * k + 2] += self.arms[k].model.wrist_sign * back_m * bump
        return control

    def _one_after_the_other(self, first: int, ways: dict[int, tuple]) -> Array:
        """Return paths on which one arm goes first and the others follow, perhaps swung aside."""
        control, curve = self._aside(ways), self.programme.curve
        for k in range(len(self.arms)):
            columns = slice(JOINTS * k, JOINTS * (k + 1))
            shares = np.clip(2 * curve.places - (k != first), 0.0, 1.0)
            control[:, columns] = curve.basis(shares) @ control[:, columns]
        return control

    def _kept(self, found: list[Array]) -> Array:
        """Return the paths changed to lie within the ranges and pass through the waypoints."""
        controls = np.stack(found)
        for k, arm in enumerate(self.arms):
            columns, spare = slice(JOINTS * k, JOINTS * (k + 1)), self.slack * (arm.model.upper - arm.model.lower)
            part = np.clip(controls[..., columns], arm.model.lower - spare, arm.model.upper + spare)
            part[:, [0, -1]] = self.plain[[0, -1], columns]
            held = self.programme.held[k]
            if len(held):
                inverse = _spread(self.programme.curve)
                across = inverse @ held.T
                off = held @ (self.plain[:, columns] - part)
                part = part + across @ np.linalg.solve(held @ across, off)
            controls[..., columns] = part
        return controls


def _spread(curve: Curve) -> Array:
    """Return the inverse (controls, controls) of the energy of the inner control points, with 0 for both ends."""
    inverse = np.zeros_like(curve.energy)
    inverse[1:-1, 1:-1] = np.linalg.inv(curve.energy[1:-1, 1:-1])
    return inverse


def plain_path(arms: tuple[ArmMotion, ...], curve: Curve, held: tuple[Array, ...]) -> Array:
    """Return the control points (controls, joints) of the path of least energy through the waypoints of all arms."""
    parts = []
    for arm, basis in zip(arms, held, strict=True):
        line = curve.line(arm.waypoints[0], arm.waypoints[-1])
        if len(basis):
            across = _spread(curve) @ basis.T
            line = line + across @ np.linalg.solve(basis @ across, arm.waypoints[1:-1] - basis @ line)
        parts.append(line)
    return np.concatenate(parts, axis=1)
