"""Two arms that do transfers side by side keep pace: both at the sources, then both at the targets."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import trio

from trocar.cell import Cell


class Pace:
    """How far each arm has come.

    Arms that go back and forth between the same sides of a board pass each other unless they go together, and one that
    comes back into the other's way has to wait for all of its way. So no arm carries its block away before the other
    one holds its own, and none leaves its target before the other one has come away from its source. An arm for which
    the other has waited for long does not keep it any longer.

    Args:
        cell: the laboratory.
        arms: names.
        patience_s: for how long an arm waits at most.
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
