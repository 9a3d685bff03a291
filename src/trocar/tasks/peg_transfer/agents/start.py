"""How the scripts of all variants begin and end: wake the arms, find the board; leave it, look once more."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager

import trio

from trocar.motion import TimedPath
from trocar.robots.concurrency import Pending, together, with_helpers
from trocar.robots.coordinator import Blocked
from trocar.tasks.peg_transfer.agents.peg_arm import ArmStopped, PegArm
from trocar.tasks.peg_transfer.agents.table import Table


async def begin(table: Table, arms: Sequence[PegArm], looks: Sequence[Callable[[], Awaitable[None]]] = ()) -> bool:
    """Wake the arms and find the board; return whether it was there.

    Args:
        table: with the board.
        arms: that work.
        looks: at the first blocks; if the settings say so, they are taken while the arms, out of the camera's view, are
            still waking.
    """
    wakes, hand = [arm.exercise_wrist for arm in arms], arms[-1].hand
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
    """Let the last arm go home, if it can, and look whether the blocks are where they were set down.

    If the settings ask for it, the image is taken half-way; what the arm hid then is checked when it is home.
    """

    async def script(helpers: trio.Nursery) -> bool | None:
        checked: Pending[bool] = Pending()

        async def look(path: TimedPath) -> bool:
            await table.cell.clock.sleep(float(path.waypoint_times_s[-2:].mean() - path.waypoint_times_s[0]))
            return await table.check(arm.hand)

        def begun(path: TimedPath) -> None:
            if table.settings.looks_ahead:
                checked.start(helpers, lambda: look(path))

        with may_stay(arm):
            await arm.go_home(begun)
        return await checked.take()

    if arm.stopped or not await with_helpers(script):
        await table.check(arm.hand)


async def withdraw(arm: PegArm) -> None:
    """Let an arm that has nothing to do leave the board, if it can."""
    with may_stay(arm):
        await arm.go_home()


@contextmanager
def may_stay(arm: PegArm) -> Iterator[None]:
    """Note it if an arm cannot leave."""
    try:
        yield
    except (Blocked, ArmStopped) as error:
        arm.cell.log.event("stayed", arm=arm.name, reason=str(error) or type(error).__name__)
