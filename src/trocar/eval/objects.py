"""What policies see of a task's objects: numbers that perception finds while the arms work."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.perception.image import Image, whole_window


class Objects(Protocol):
    """A task's objects as perception finds them while arms work, as numbers for a policy.

    One is made for each trial from the cell, the goals, what is known beforehand (``Task.nominal``), and a perception.

    Attributes:
        names: the numbers' names.
    """

    names: Sequence[str]

    @property
    def values(self) -> NDArray[np.float64]:
        """Return the latest numbers, each from -1 to 1: m in the world, sines, cosines, yes (1) or no (0)."""
        ...

    async def watch(self) -> None:
        """Look again and again, until cancelled."""
        ...


class WatchedObjects(ABC):
    """Objects at which one camera looks again and again; a task implements :meth:`find` and :meth:`take`.

    Class attributes:
        every_s: time from one look to the next, on the cell's clock.
        budget_s: time declared for :meth:`find`.
    """

    every_s: ClassVar[float] = 1.0
    budget_s: ClassVar[float]

    def __init__(self, cell: Cell, camera: str):
        self.cell, self._camera = cell, cell.cameras[camera]
        self.T_world_camera = cell.T_world_camera_registered[camera]

    @abstractmethod
    def find(self, image: Image) -> Any:
        """Return what a whole image shows, without changing this object."""

    @abstractmethod
    def take(self, found: Any) -> None:
        """Update the numbers with what :meth:`find` returned."""

    async def watch(self) -> None:
        """Look again and again, until cancelled."""
        clock, whole = self.cell.clock, whole_window(self._camera.model)
        while True:
            began_s = clock.now_s()
            image = await self._camera.capture(whole)
            found, seconds = await clock.compute(partial(self.find, image), self.budget_s)
            self.cell.log.compute("objects", seconds, self.budget_s)
            self.take(found)
            await clock.sleep(max(0.0, began_s + self.every_s - clock.now_s()))
