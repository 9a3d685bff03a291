"""Between two trials: what the last one gave, and what the person runs next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from trocar.view.console_view import Standing
from trocar.view.live import BAD, WAITS
from trocar.view.wishes import Level, Said, Wish


@dataclass(eq=False)
class Lobby:
    """The console while no trial runs. What the person sets here holds for the next trial.

    Attributes:
        words: what the last trial gave.
        methods: among which the person may choose.
        level: what a script needs confirmation for.
        speed: of the next trial's clock.
        paced: whether that clock is a simulator's.
        stopped: whether the arms of the next trial are stopped until the person lets them go on.
        paused: whether its clock is paused.
        chosen: the method with which the next trial begins; empty: not yet.
    """

    words: str
    methods: Sequence[str]
    level: Level
    speed: float
    paced: bool
    stopped: bool = False
    paused: bool = False
    chosen: str = ""

    now_s: ClassVar[float] = 0.0
    asks: ClassVar[bool] = False
    ended: ClassVar[str] = ""
    needed: ClassVar[bool] = False

    def take_in(self, said: Said) -> None:
        """Process a wish; most are for a trial, and count for nothing here."""
        match said.wish:
            case Wish.BEGIN if said.value in self.methods:
                self.chosen = said.value
            case Wish.STOP | Wish.EMERGENCY:
                self.stopped = True
            case Wish.GO_ON:
                self.stopped = False
            case Wish.LEVEL:
                self.level = said.value
            case Wish.SPEED if self.paced:
                self.speed = said.value
            case Wish.PAUSE if self.paced:
                self.paused = said.value

    @property
    def standing(self) -> Standing:
        """Return the state for the page."""
        words, methods = f"{self.words}. Choose a method and begin a trial", tuple(self.methods)
        if self.chosen:
            words, methods = f"Sets up a trial with {self.chosen}", ()
        if self.stopped:
            words += " (the arms are stopped until you press Go on)"
        if self.paused:
            words += " (its clock is paused)"
        return Standing(
            words,
            colour=BAD if self.stopped else WAITS,
            level=self.level,
            speed=self.speed if self.paced else None,
            stopped=self.stopped,
            methods=methods,
            idle=True,
        )
