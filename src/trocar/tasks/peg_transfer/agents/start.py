"""How the scripts of all variants begin and end: wake the arms, find the board; leave it, look once more."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

import trio

from trocar.motion import TimedPath
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.table import Table
from trocar.tasks.peg_transfer.agents.together import Pending, together, with_helpers


async def begin(table: Table, arms: Sequence[PegArm], looks: Sequence[Callable[[], Awaitable[None]]] = ()) -> bool:
    """Wake the arms and find the board; return whether it was there.

    Args:
        table: with the board.
        arms: that work.
        looks: at the first blocks; they are done while the arms, out of the camera's view, still wake, if the settings
            say so.
    """
    wakes, hand = [arm.wake for arm in arms], arms[-1].hand
    if not table.settings.looks_ahead:
        await together(*wakes)
        return await table.find_board(hand)
    found: list[bool] = []

    async def look() -> None:
        found.append(await table.find_board(hand))
        if found[0]:
            for first in looks:
                await first()

    await together(*wakes, look)
    return found[0]


async def finish(table: Table, arm: PegArm) -> None:
    """Let the last arm go home, and look whether the blocks lie where they were set down.

    If the settings say so, one looks when it is half-way; what it hid then is looked at when it is home.
    """

    async def script(helpers: trio.Nursery) -> bool | None:
        checked: Pending[bool] = Pending()

        async def look(path: TimedPath) -> bool:
            await table.cell.clock.sleep(float(path.waypoint_times_s[-2:].mean() - path.waypoint_times_s[0]))
            return await table.check(arm.hand)

        def begun(path: TimedPath) -> None:
            if table.settings.looks_ahead:
                checked.start(helpers, lambda: look(path))

        await arm.go_home(begun)
        return await checked.take()

    if not await with_helpers(script):
        await table.check(arm.hand)
