"""An arm's script whose jaws open as wide as it asks, whatever the play in their cable, and need not be waited for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import trio

from trocar.cell import MotionResult
from trocar.robots import TICK_S
from trocar.robots.arm_script import ArmScript

LOOSE_RAD = 0.03
"""Jaws that loosen their grip are commanded to close by this much more than they can."""
STILL, STILL_RAD = 3, 0.01
"""Closing jaws have been stopped by something if they moved by more than this angle from one reading to the next, and
are at none of the following readings, of this number, further closed by more than it. Fingers rebound from a wall by
.03 rad, for .03 s. Jaws that a person stops come to rest gradually."""
PARTED_RAD = 0.08
"""Additional opening after which an arm may rise from what it held; the jaws open further while it gathers speed."""
TO_GO_RAD = 0.05
"""Jaws this close to where they are going are waited for."""


@dataclass(eq=False)
class PegHand(ArmScript):
    """One arm as this task's scripts use it.

    The encoder of the jaws sits at their motor. Fingers that close follow it, as the zero of the readings does; to open
    them, it first has to go through the play.

    Attributes:
        jaw_play_rad: by how much jaws that have opened are narrower than their encoder says.
        waits: whether to wait until jaws that close or part are at rest; else ``go_on_with_jaw`` has to follow.
        jaw_goal_rad: the opening to which they were last driven.
    """

    jaw_play_rad: float = 0.0
    waits: bool = True
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

    async def part(self, angle_rad: float) -> None:
        """Open the jaws to an opening; unless it ``waits``, return once they have parted."""
        if self.waits:
            await self.jaw(angle_rad)
        else:
            parted_rad = self.jaw_rad + PARTED_RAD
            await self._drive_until(angle_rad, lambda: self.jaw_rad > parted_rad)

    async def close_on(self, angle_rad: float) -> float:
        """Close the jaws to an opening; unless it ``waits``, return once something has stopped them on the way.

        Returns:
            The opening at which they were stopped, or have come to rest.
        """
        if self.waits:
            await self.jaw(angle_rad)
            return self.jaw_rad
        read_rad, read_s = [self.jaw_rad], self._read_s

        def stopped() -> bool:
            nonlocal read_s
            if self._read_s > read_s:  # a reading may come late over a network, and the last one is then repeated
                read_s = self._read_s
                read_rad.append(self.jaw_rad)
            if len(read_rad) < STILL + 2:
                return False
            before, last, *after = read_rad[-STILL - 2 :]
            return before - last > STILL_RAD and min(after) > max(last - STILL_RAD, angle_rad + TO_GO_RAD)

        return min(read_rad[-STILL:]) if await self._drive_until(angle_rad, stopped) else self.jaw_rad

    @property
    def _read_s(self) -> float:
        return self.cell.robot.read(self.name).time_s

    async def go_on_with_jaw(self) -> None:
        """Let jaws that had not arrived go on to where they were driven, while the arm moves."""
        if self._under_way:
            self._under_way = False
            await super().drive_jaw(self.jaw_goal_rad + (self.jaw_play_rad if self._opened else 0.0))

    async def _drive_until(self, angle_rad: float, enough: Callable[[], bool]) -> bool:
        """Drive the jaws until their readings are enough, or they are at rest; return whether they are under way."""

        async def drive() -> None:
            await self.jaw(angle_rad)
            nursery.cancel_scope.cancel()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(drive)
            while not enough():
                await self.cell.clock.sleep(TICK_S)
            self._under_way = True
            nursery.cancel_scope.cancel()
        return self._under_way
