"""Everything that may collide, as one numbered list of capsules over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from trocar.arms.solids import SOLIDS, solid_radii_m
from trocar.geometry.capsules import Capsules
from trocar.motion.chord_error import greatest_accelerations
from trocar.motion.moving_arm import MovingArm
from trocar.motion.obstacles import Obstacle, stacked


@dataclass(frozen=True, eq=False)
class Bodies:
    """The capsules of moving arms, then those of obstacles, and which pairs of them count.

    Attributes:
        movers: the arms, four capsules each.
        still: the obstacles.
        names: of every capsule, as in ``"psm1 left finger"``.
        radii_m: (bodies,).
        pairs: (pairs, 2) indices of bodies.
        owners: name of the arm that each of the movers' capsules belongs to.
    """

    movers: tuple[MovingArm, ...]
    still: Capsules
    names: tuple[str, ...]
    radii_m: NDArray[np.float64]
    pairs: NDArray[np.intp]
    owners: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, arms: Mapping[str, MovingArm], others: Mapping[str, MovingArm], obstacles: Mapping[str, Obstacle]
    ) -> Bodies:
        """Return the bodies; pairs are of two planned arms, or of a planned arm and another arm or an obstacle."""
        movers = (*arms.values(), *others.values())
        still = stacked(obstacles)
        names = [f"{name} {solid}" for name in (*arms, *others) for solid in SOLIDS] + list(obstacles)
        radii = [solid_radii_m(arm.model) for arm in movers]
        groups = [range(len(SOLIDS) * k, len(SOLIDS) * (k + 1)) for k in range(len(movers))]
        groups += [range(k, k + 1) for k in range(len(SOLIDS) * len(movers), len(names))]
        meeting = (pair for pair in combinations(range(len(groups)), 2) if pair[0] < len(arms))
        pairs = [both for a, b in meeting for both in product(groups[a], groups[b])]
        return cls(
            movers,
            still,
            tuple(names),
            np.concatenate([*radii, still.radii_m]),
            np.array(pairs, dtype=np.intp).reshape(-1, 2),
            tuple(name for name in (*arms, *others) for _ in SOLIDS),
        )

    def arms_of(self, pair: NDArray[np.intp]) -> tuple[str, ...]:
        """Return the names of the arms to which two bodies belong."""
        return tuple(self.owners[body] for body in pair if body < len(self.owners))

    def ends_m(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return both ends of every capsule in the world at the times (n,): (n, bodies, 2, 3) m."""
        still = np.broadcast_to(self.still.ends_m, (len(t_s), *self.still.ends_m.shape))
        return np.concatenate([*(arm.ends_m(t_s) for arm in self.movers), still], axis=1)

    def accelerations(self, begin_s: NDArray[np.float64], end_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return bounds on the acceleration of every point of every capsule over intervals: (n, bodies) m/s^2."""
        still = np.zeros((len(begin_s), len(self.still.radii_m)))
        return np.concatenate([*(greatest_accelerations(arm, begin_s, end_s) for arm in self.movers), still], axis=1)
