"""What a policy sees of a debridement: fragments, from pairs of images taken beside whatever the arms do."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.perception.image import StereoImage, StereoRig, StereoWindow, Window
from trocar.tasks.debridement.goals import Clearing, Workspace
from trocar.tasks.debridement.perception.fragments import SeenFragment

EVERY_S, BUDGET_S = 1.0, 0.3
"""Time from one look to the next, and time declared for finding fragments in a pair of whole images."""
SAME_M = 0.02
"""A fragment that is seen within this of where one was seen before is the same."""
_OF_FRAGMENT = (*(f"position.{axis}" for axis in "xyz"), "cos_2yaw", "sin_2yaw", "seen")


class DebridementObjects:
    """Each fragment in the world, as last seen; which number a fragment has never changes.

    Of a fragment: its middle (m), cosine and sine of twice the yaw of its long side, since both its ends are alike, and
    whether the last look showed it. All are 0 before it has been seen.

    Attributes:
        names: of the numbers.
        values: the numbers, each from -1 to 1.
    """

    def __init__(self, cell: Cell, goals: Sequence[Clearing], nominal: Workspace, perception: Any):
        self._cell, self._see = cell, perception
        self._name = next(name for name, camera in cell.cameras.items() if isinstance(camera.model, StereoRig))
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

    async def watch(self) -> None:
        """Look again and again, for ever."""
        cell, clock = self._cell, self._cell.clock
        camera, T_world_camera = cell.cameras[self._name], cell.T_world_camera_registered[self._name]
        assert isinstance(camera.model, StereoRig)
        left, right = (Window((0, 0), (eye.width, eye.height)) for eye in (camera.model.left, camera.model.right))
        whole = StereoWindow(left, right)  # a camera keeps images without a window
        while True:
            began_s = clock.now_s()
            image = await camera.capture(whole)
            assert isinstance(image, StereoImage)
            find = partial(self._see.fragments, image, T_world_camera, cell.T_world_fixture["table"], cell.arms)
            seen, seconds = await clock.compute(find, BUDGET_S)
            cell.log.compute("objects", seconds, BUDGET_S)
            self._take(seen)
            await clock.sleep(max(0.0, began_s + EVERY_S - clock.now_s()))

    def _take(self, seen: Sequence[SeenFragment]) -> None:
        """Give each fragment that is seen the number that it has, or a new one."""
        self._in_view = set()
        left = sorted(seen, key=lambda one: one.p_world_m[0])
        pairs = [(one.away_m(k.p_world_m), i, j) for i, one in enumerate(left) for j, k in enumerate(self._known)]
        given: set[int] = set()
        for away_m, i, j in sorted(pairs):
            if away_m < SAME_M and i not in given and j not in self._in_view:
                self._known[j] = left[i]
                given.add(i)
                self._in_view.add(j)
        for i, one in enumerate(left):
            if i not in given and len(self._known) < self._most:
                self._in_view.add(len(self._known))
                self._known.append(one)
