"""An arm's script whose jaws open as wide as it asks, whatever the play in their cable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

import trio

from trocar.cell import MotionResult
from trocar.robots import TICK_S
from trocar.robots.arm_script import ArmScript

LOOSE_RAD = 0.03
"""Jaws that loosen their grip are commanded to close by this much more than they can."""
MOVED_RAD = 0.05
"""Something has stopped closing jaws that have moved by this much, still have as far to go, and stand still."""
STILL, STILL_RAD = 3, 0.01
"""They stand still if none of this many readings, one in a tick, is closer than those before by this much. They may be
further open: fingers rebound from a wall by .03 rad, for .03 s."""


@dataclass(eq=False)
class PegHand(ArmScript):
    """One arm as this task's scripts use it.

    The encoder of the jaws sits at their motor. Fingers that close follow it, as the zero of the readings does; to open
    them, it first has to go through the play.

    Attributes:
        jaw_play_rad: by how much jaws that have opened are narrower than their encoder says.
        jaw_goal_rad: the opening to which they were last driven.
    """

    jaw_play_rad: float = 0.0
    jaw_goal_rad: float = field(default=0.0, init=False)
    _opened: bool = field(default=False, init=False)  # whether the jaws were last told to open
    _under_way: bool = field(default=False, init=False)  # whether nobody waited until they arrived

    @property
    def jaw_rad(self) -> float:
        """Return the opening between the fingers, as far as the encoder and the play tell it."""
        return super().jaw_rad - (self.jaw_play_rad if self._opened else 0.0)

    async def drive_jaw(self, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening; to open them, by the play further."""
        self.jaw_goal_rad, self._opened, self._under_way = angle_rad, angle_rad > self.jaw_rad, False
        return await super().drive_jaw(angle_rad + (self.jaw_play_rad if self._opened else 0.0))

    async def loosen_jaw(self) -> None:
        """Let jaws that press on something press less, so that they part as soon as they are told to."""
        await self.drive_jaw(self.jaw_rad - LOOSE_RAD)

    async def open_by(self, angle_rad: float, enough_rad: float) -> None:
        """Drive the jaws to an opening; return once they have opened by ``enough_rad``: see ``go_on_with_jaw``."""
        before_rad = self.jaw_rad
        await self._drive_until(angle_rad, lambda: self.jaw_rad > before_rad + enough_rad)

    async def close_on(self, angle_rad: float) -> None:
        """Drive the jaws to an opening; return once something has stopped them on the way: see ``go_on_with_jaw``."""
        read_rad = [self.jaw_rad]

        def stopped() -> bool:
            read_rad.append(self.jaw_rad)
            before, lately = min(read_rad[:-STILL], default=inf), min(read_rad[-STILL:])
            return before < read_rad[0] - MOVED_RAD and lately > max(before - STILL_RAD, angle_rad + MOVED_RAD)

        await self._drive_until(angle_rad, stopped)

    async def go_on_with_jaw(self) -> None:
        """Let jaws that had not arrived go on to where they were driven, while the arm moves."""
        if self._under_way:
            self._under_way = False
            await super().drive_jaw(self.jaw_goal_rad + (self.jaw_play_rad if self._opened else 0.0))

    async def _drive_until(self, angle_rad: float, enough: Callable[[], bool]) -> None:
        """Drive the jaws to an opening; return when their readings are enough, at the latest when they are at rest."""

        async def drive() -> None:
            await self.jaw(angle_rad)
            nursery.cancel_scope.cancel()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(drive)
            while not enough():
                await self.cell.clock.sleep(TICK_S)
            self._under_way = True
            nursery.cancel_scope.cancel()
