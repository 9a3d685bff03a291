"""A policy's observation of debridement: fragments, from pairs of images that are taken while the arms work."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from trocar.cell import Cell
from trocar.eval.objects import WatchedObjects
from trocar.perception.image import Image, StereoRig
from trocar.tasks.debridement.goals import Clearing, Workspace
from trocar.tasks.debridement.perception.fragments import SeenFragment

SAME_M = 0.02
"""A fragment seen this close to the last place of a known one is that one."""
_OF_FRAGMENT = (*(f"position.{axis}" for axis in "xyz"), "cos_2yaw", "sin_2yaw", "seen")


class DebridementObjects(WatchedObjects):
    """Each fragment in the world, as last seen; a fragment that lies still keeps its index.

    A fragment that was carried takes an index that is not in view, the one with the nearest last place if there are
    several. That is its own index, unless another fragment was hidden meanwhile.

    The numbers of a fragment are: its middle (m), cosine and sine of twice the yaw of its long side, since both its
    ends are alike, and whether the last look showed it. All are 0 before it has been seen.

    Attributes:
        names: names of the numbers.
        values: the numbers, each from -1 to 1.
    """

    budget_s = 0.3

    def __init__(self, cell: Cell, goals: Sequence[Clearing], nominal: Workspace, perception: Any):
        del nominal
        super().__init__(cell, next(name for name, one in cell.cameras.items() if isinstance(one.model, StereoRig)))
        self._see = perception
        self.names = [f"fragment{number}.{name}" for number in range(1, len(goals) + 1) for name in _OF_FRAGMENT]
        self._known: list[SeenFragment] = []
        self._in_view: set[int] = set()
        self._most = len(goals)

    @property
    def values(self) -> NDArray[np.float64]:
        """Return the numbers as they are now known."""
        rows = np.zeros((self._most, len(_OF_FRAGMENT)))
        for number, one in enumerate(self._known):
            turn = np.cos(2 * one.yaw_rad), np.sin(2 * one.yaw_rad)
            rows[number] = *one.p_world_m, *turn, float(number in self._in_view)
        return np.clip(rows.ravel(), -1.0, 1.0)

    def find(self, image: Image) -> list[SeenFragment]:
        """Return the fragments that both eyes see."""
        return self._see.fragments(image, self.T_world_camera, self.cell.T_world_fixture["table"], self.cell.arms)

    def take(self, found: Sequence[SeenFragment]) -> None:
        """Give each visible fragment the index that it had, a new one or, if all are taken, one that is not in view."""
        self._in_view = set()
        left = sorted(found, key=lambda one: one.p_world_m[0])
        pairs = [(one.away_m(k.p_world_m), i, j) for i, one in enumerate(left) for j, k in enumerate(self._known)]
        given: set[int] = set()
        for away_m, i, j in sorted(pairs):
            if away_m < SAME_M and i not in given and j not in self._in_view:
                self._known[j] = left[i]
                given.add(i)
                self._in_view.add(j)
        news = [one for i, one in enumerate(left) if i not in given]
        free = self._most - len(self._known)
        self._in_view |= set(range(len(self._known), len(self._known) + len(news[:free])))
        self._known += news[:free]
        carried, missing = news[free:], [j for j in range(self._most) if j not in self._in_view]
        if carried and missing:
            away = [[one.away_m(self._known[j].p_world_m) for j in missing] for one in carried]
            for i, j in zip(*linear_sum_assignment(away), strict=True):
                self._known[missing[j]] = carried[i]
                self._in_view.add(missing[j])
