"""The receptacle's token (Kehoe 2014, V-C.2): the arm that holds it may be over the receptacle."""

from __future__ import annotations

from collections import deque

import trio

from trocar.errors import TrocarError


class Token:
    """One token for all arms, handed out in the order of waiting. It belongs to an arm, whichever of its tasks asks."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self._waiting: deque[tuple[str, trio.Event]] = deque()

    def take_now(self, arm: str) -> bool:
        """Take it if it is free; return whether the arm has it."""
        if self.holder is None:
            self.holder = arm
        return self.holder == arm

    async def take(self, arm: str) -> None:
        """Take it, or wait until it is handed over."""
        if self.take_now(arm):
            return
        turn = arm, trio.Event()
        self._waiting.append(turn)
        try:
            await turn[1].wait()
        except trio.Cancelled:
            if self.holder == arm:
                self.give_back(arm)
            else:
                self._waiting.remove(turn)
            raise

    def give_back(self, arm: str) -> None:
        """Hand it over to the arm that waits.

        Raises:
            TrocarError: another arm has it.
        """
        if self.holder != arm:
            raise TrocarError(f"arm {arm!r} gives back a token that {self.holder or 'nobody'!r} holds")
        self.holder = None
        if self._waiting:
            self.holder, turn = self._waiting.popleft()
            turn.set()

    def drop(self, arm: str) -> None:
        """Give it back if this arm has it."""
        if self.holder == arm:
            self.give_back(arm)
