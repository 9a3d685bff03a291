"""Two arms that work side by side keep pace: both at the sources, then both at the targets."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import trio

from trocar.cell import Cell


class Pace:
    """The progress of each arm.

    Arms that go back and forth between the same sides of a board have to pass each other unless they move together, and
    one that comes back into the other's way has to wait until the other has passed completely. So no arm carries its
    block away before the other holds its own, and none leaves its target before the other has left its source. An arm
    does not wait for the other longer than ``patience_s``.

    Args:
        cell: the laboratory.
        arms: names.
        patience_s: maximum waiting time.
    """

    def __init__(self, cell: Cell, arms: Sequence[str], patience_s: float):
        self._cell, self._patience_s = cell, patience_s
        self._steps = dict.fromkeys(arms, 0.0)
        self._changed = trio.Event()

    def come(self, arm: str, step: float = inf) -> None:
        """Note that an arm has reached a step; by default, that it has finished."""
        self._steps[arm] = step
        changed, self._changed = self._changed, trio.Event()
        changed.set()

    async def wait(self, arm: str, step: float) -> None:
        """Wait until all other arms have reached a step."""
        others = [name for name in self._steps if name != arm]
        if all(self._steps[name] >= step for name in others):
            return
        with self._cell.log.span(arm, "waiting"), trio.move_on_after(self._patience_s):
            while any(self._steps[name] < step for name in others):
                await self._changed.wait()
