"""Arms that a person takes over from a script, moves, and returns."""

from __future__ import annotations

from typing import Protocol

import trio

from trocar.cell import Cell
from trocar.console.hand import Hand
from trocar.errors import AlreadyThere, MotionRefused
from trocar.robots.supervised import StoppedByPerson, Supervised


class Desk(Protocol):
    """Where the person sits: the console, as the lent arms see it."""

    stopped: bool
    """Whether all arms are stopped."""
    hands: dict[str, Hand]
    """The arms that the person moves."""
    latencies_s: list[float]
    """Time from each input to the set-point that followed it."""

    async def changed(self) -> None:
        """Return at the next wish of the person, or the next change of an arm's state."""
        ...

    def tell(self) -> None:
        """Wake everybody who waits for a change."""
        ...


class Lending:
    """Lends arms to a person, and brings each back to where the script left it before the script may use it again.

    Args:
        desk: of the person.

    Attributes:
        arms: those that the script must not use.
    """

    def __init__(self, desk: Desk):
        self._desk = desk
        self.arms: set[str] = set()
        self._scopes: dict[str, trio.CancelScope] = {}
        self._returned: dict[str, bool] = {}  # arms whose jaws still return: whether to take them over again

    def take(self, arm: str) -> None:
        """Let the person have an arm as soon as it is at rest; again, if its jaws are still on their way back."""
        if arm in self._returned:
            self._returned[arm] = True
        self.arms.add(arm)

    def may_return(self, arm: str) -> bool:
        """Return whether an arm can be returned now."""
        return arm in self._returned or (arm in self._scopes and not self._desk.stopped)

    def give_back(self, arm: str) -> None:
        """Bring an arm that may be returned back to where the script left it."""
        if arm in self._returned:
            self._returned[arm] = False
        else:
            self._scopes[arm].cancel()

    def begin(self, nursery: trio.Nursery, cell: Cell, robot: Supervised) -> None:
        """Lend the arms that were taken since the last call."""
        for arm in self.arms - set(self._scopes):
            self._scopes[arm] = trio.CancelScope()
            nursery.start_soon(self._lend, cell, robot, arm)

    async def _lend(self, cell: Cell, robot: Supervised, arm: str) -> None:
        """Let the person move an arm, then return it along the same path to where the script left it."""
        cell.robot.hold(arm, reason=StoppedByPerson(arm))
        await cell.robot.rest(arm)
        robot.lend(arm)
        jaw_rad = robot.jaws_rad.get(arm)
        hand = self._desk.hands[arm] = Hand(cell, arm, jaw_rad)
        cell.log.event("taken over", arm=arm)
        try:
            while not await self._brought_back(cell, hand):
                self._scopes[arm] = trio.CancelScope()
        finally:
            self._desk.hands.pop(arm)
            self._desk.latencies_s += hand.latencies_s
        self._returned[arm] = False
        while jaw_rad is not None:
            while self._desk.stopped:
                await self._desk.changed()
            result = await cell.robot.jaw(arm, jaw_rad)
            if not isinstance(result.cause, StoppedByPerson):
                break
        cell.log.event("handed back", arm=arm)
        del self._scopes[arm]
        if not self._returned.pop(arm):
            self.arms.discard(arm)
        self._desk.tell()

    async def _brought_back(self, cell: Cell, hand: Hand) -> bool:
        """Let the person move the arm until they return it; return whether it came all the way back."""
        with self._scopes[hand.arm]:
            await hand.follow()
        hand.release()
        cell.robot.hold(hand.arm)
        await cell.robot.rest(hand.arm)
        if self._desk.stopped:  # meanwhile
            return False
        try:
            result = await cell.robot.move({hand.arm: hand.way_back()})
        except AlreadyThere:
            return True
        except MotionRefused as error:
            hand.refused = f"the way back is refused: {error}"
            cell.log.event("refused", arm=hand.arm, reason=str(error))
            return False
        if not result[hand.arm].done:
            hand.forget_way_back()
        return result[hand.arm].done
