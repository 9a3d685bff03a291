"""What the referee of debridement saw: simulator truth, only for the score. No agent may import this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.tasks.debridement.goals import Receptacle

HEAP_M = 0.015  # a fragment on a heap counts as in the receptacle up to this height over its edge: two layers


@dataclass(frozen=True, eq=False)
class Sights:
    """The fragments that a camera could have seen, checked at intervals."""

    times_s: NDArray[np.float64]  # (m,) trial clock, in order
    seen: NDArray[np.float64]  # (m, k) share of a fragment's points that no other body hides from either eye


@dataclass(frozen=True, eq=False)
class DebridementTruth:
    """The true poses of everything, and what the arms' fingers touched. Mappings are by arm."""

    times_s: NDArray[np.float64]  # (n,) trial clock
    T_world_fragments: SE3  # (n, k)
    # (n, k) whether a fragment is between an arm's fingers: both touch it, or each one of two that press on each other
    held_by: Mapping[str, NDArray[np.bool_]]
    touched_by: Mapping[str, NDArray[np.bool_]]  # (n, k) whether any finger touches a fragment
    jaw_rad: Mapping[str, NDArray[np.float64]]  # (n,) opening of the jaws
    T_world_tips: Mapping[str, SE3]  # (n,)
    T_world_receptacle: SE3
    receptacle: Receptacle
    table_z_m: float  # height of the work surface
    sights: Sights

    @property
    def count(self) -> int:
        """Return how many fragments there are."""
        return self.T_world_fragments.matrix.shape[1]

    @property
    def p_world_fragments_m(self) -> NDArray[np.float64]:
        """Return the middles (n, k, 3) of the fragments."""
        return self.T_world_fragments.translation_m

    def row(self, time_s: float) -> int:
        """Return the row of the last tick not after this time."""
        return min(max(0, int(np.searchsorted(self.times_s, time_s + 1e-9)) - 1), len(self.times_s) - 1)

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Return whether a fragment (n, k) is held by any arm."""
        return np.any(list(self.held_by.values()), axis=0)

    @cached_property
    def touched(self) -> NDArray[np.bool_]:
        """Return whether any finger of any arm touches a fragment (n, k)."""
        return np.any(list(self.touched_by.values()), axis=0)

    @cached_property
    def between_walls(self) -> NDArray[np.bool_]:
        """Return whether a fragment's middle (n, k) is inside the receptacle, or on a heap in it."""
        p = self.p_world_fragments_m
        edge_m = self.T_world_receptacle.translation_m[2] + self.receptacle.height_m
        return self.over_receptacle(p) & (p[..., 2] < edge_m + HEAP_M)

    def over_receptacle(self, p_world: NDArray[np.float64], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return whether points (..., 3) are above the receptacle's inside, or within a margin beside it."""
        p = self.T_world_receptacle.inverse().apply(p_world)
        near = np.abs(p[..., :2]) < 0.5 * np.array(self.receptacle.size_m) + margin_m
        return np.all(near, axis=-1)
