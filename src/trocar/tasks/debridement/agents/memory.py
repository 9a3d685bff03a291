"""Memory of fragments that a pair of images does not show: some are hidden, and some are carried."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.capsules import Capsules, segment_distances_m
from trocar.tasks.debridement.perception.seen import SAME_M, SeenFragment, away_m

LYING_M = 0.012
"""Middles of fragments on the work surface are lower than this; others are held, and not remembered."""
ROUND_M = 0.008
"""An arm may hide fragments this far beyond its outline: its pose is an estimate, and what it carries sticks out."""
MOVED_M = 0.016
"""Jaws that approach a fragment may shift it unseen, by half of their opening plus half its length at most."""
FINGERS = slice(2, 4)
"""The fingers among an arm's capsules."""


class Memory:
    """The fragments on the work surface as last seen, and which arms carry something."""

    def __init__(self) -> None:
        self._lying: list[SeenFragment] = []
        self._carrying: set[str] = set()

    def look(
        self, seen: Sequence[SeenFragment], p_world_eyes_m: NDArray[np.float64], arms: Mapping[str, Capsules]
    ) -> tuple[list[SeenFragment], list[SeenFragment]]:
        """Return what a pair of images shows outside the jaws, and the fragments that arms hide in it.

        A fragment that is neither seen nor hidden is gone, and is forgotten. One that appears beside a hidden one is
        that one, shifted.

        Args:
            seen: in the images.
            p_world_eyes_m: (2, 3) where both eyes are, the left one first.
            arms: their solids in the world, approximately where they were in the images.
        """
        fingers = [Capsules(arms[arm].ends_m[FINGERS], arms[arm].radii_m[FINGERS]) for arm in self._carrying]
        shown = [new for new in seen if not _is_behind(new, p_world_eyes_m[:1], fingers)]
        appeared = [new for new in shown if all(away_m(new, old.p_world_m) > SAME_M for old in self._lying)]
        hidden = [
            old
            for old in self._lying
            if all(away_m(old, new.p_world_m) > SAME_M for new in shown)
            and all(away_m(old, new.p_world_m) > MOVED_M for new in appeared)
            and _is_behind(old, p_world_eyes_m, arms.values())
        ]
        self._lying = [*(fragment for fragment in shown if fragment.height_m < LYING_M), *hidden]
        return shown, hidden

    def take(self, arm: str, p_world_m: NDArray[np.float64]) -> None:
        """Record that the jaws of an arm have closed on what lay at a place (3,), or was shifted from there."""
        self._lying = [old for old in self._lying if away_m(old, p_world_m) > MOVED_M]
        self._carrying.add(arm)

    def let_go(self, arm: str) -> None:
        """Record that the jaws of an arm have opened again."""
        self._carrying.discard(arm)


def _is_behind(fragment: SeenFragment, p_world_eyes_m: NDArray[np.float64], solids: Iterable[Capsules]) -> bool:
    """Return whether the line of sight from one of the eyes to a fragment passes through or close to these solids."""
    near = ROUND_M + 0.5 * float(fragment.extent_m[0])
    for capsules in solids:
        ends = capsules.ends_m
        for eye in p_world_eyes_m:
            away = segment_distances_m(ends[:, 0], ends[:, 1], eye, fragment.p_world_m)
            if (away < capsules.radii_m + near).any():
                return True
    return False
