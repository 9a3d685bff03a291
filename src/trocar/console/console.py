"""The console of a cell: carries out what a person at the page asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import trio
from trio.testing import wait_all_tasks_blocked

from trocar.cell import Cell, GoalOffer
from trocar.console.hand import Hand
from trocar.console.lending import Lending
from trocar.console.question import Paths, Question
from trocar.errors import EmergencyStop, InvalidInput
from trocar.robots import TICK_S
from trocar.robots.supervised import StoppedByPerson, Supervised, Vetoed
from trocar.trajectory import Trajectory
from trocar.view.console_view import Standing
from trocar.view.live import BAD, GOOD, WAITS
from trocar.view.wishes import Level, Said, Wish

POLL_S = 0.01
"""Interval at which the page is polled while the clock is paused."""
STREAMED = (Wish.HOLD, Wish.RELEASE, Wish.SPEED, Wish.PAUSE, Wish.STEP)
"""Wishes that are not logged: many a second, as may be a device's jaw commands, or only about the clock."""


class Console:
    """A person's control of one cell: the pace of its clock, the permission of motions, and who moves its arms.

    In the simulator, the clock is paused while a motion waits for confirmation. So a trial in which the person only
    confirms is that of the script alone, except for the events that say so. On real arms, time goes on.

    Args:
        level: what a script needs confirmation for.
        speed: seconds of the cell's clock per second; 0: no limit.
        noun: noun for the task's goals; an event of this name ends a goal.
        hear: returns the wishes since the last call; called each tick.
        show: updates the page; called each tick.
        paced: whether a simulator's clock waits for the console each tick (``wait``); else ``serve`` polls the page.
        over: returns whether the cell is ending, so that its clock must not pause any more.
        stopped: whether the arms were stopped before; then nothing moves until the person lets them go on.
        paused: whether the clock was paused before.

    Attributes:
        cell: below any compensation; None before ``supervise``.
        hands: the arms that the person moves.
        latencies_s: time from each input to the set-point that followed it.
        stopped: whether the arms are stopped.
        paused: whether the person has paused the clock.
        ended: why the person ended the trial; empty if nobody did.
    """

    def __init__(
        self,
        level: Level = Level.AUTONOMOUS,
        speed: float = 1.0,
        *,
        noun: str = "",
        hear: Callable[[], Iterable[Said]] = tuple,
        show: Callable[[], None] = lambda: None,
        paced: bool = True,
        over: Callable[[], bool] = lambda: False,
        stopped: bool = False,
        paused: bool = False,
    ):
        self.level, self.speed, self._noun, self._hear, self._show = level, speed, noun, hear, show
        self._paced, self._over = paced, over
        self.cell: Cell | None = None
        self.hands: dict[str, Hand] = {}
        self.latencies_s: list[float] = []
        self._robot: Supervised | None = None
        self._question: Question | None = None
        self._asked, self._goal_begins, self._offers, self._works = 0, True, False, False
        self.stopped, self.paused, self.ended = stopped, paused, ""
        self._lending = Lending(self)
        self._changed, self._done, self._paths = trio.Event(), trio.Event(), Paths()
        self._steps, self._due_s = 0, math.nan

    def supervise(self, cell: Cell) -> Supervised:
        """Return a cell's robot under the person's supervision; only its guard may have wrapped it already."""
        self._robot = Supervised(cell.robot, self)
        self.cell = cell
        return self._robot

    @property
    def _own_cell(self) -> Cell:
        if self.cell is None:
            raise InvalidInput("the console", "is at no cell yet", "call supervise() first")
        return self.cell

    # implements trocar.sim.pace.Pace

    async def wait(self, now_s: float) -> None:
        """Return when the next tick may begin: at the chosen speed, and not while the clock is paused."""
        while True:
            if self._listen():
                await wait_all_tasks_blocked()  # what the answer lets start begins in this tick
            self._show()
            if not self._stands:
                break
            self._due_s = math.nan
            await trio.to_thread.run_sync(time.sleep, POLL_S)
        self._steps = max(0, self._steps - 1)
        if self.speed > 0:
            now = time.perf_counter()
            self._due_s = now if math.isnan(self._due_s) else max(self._due_s + TICK_S / self.speed, now - TICK_S)
            if self._due_s > now:
                await trio.to_thread.run_sync(time.sleep, self._due_s - now)

    @property
    def asks(self) -> bool:
        """Return whether a motion or a goal waits for confirmation, and for nothing else."""
        return self._question is not None and not (self.stopped or self._lending.arms)

    @property
    def _stands(self) -> bool:
        return not self.ended and (self.asks or (self.paused and not self._steps)) and not self._over()

    # implements trocar.robots.supervised.Supervisor

    async def permit(self, motions: Mapping[str, Trajectory], *, begun: bool = False) -> None:
        """Return once these motions may start; see ``Supervisor.permit``."""
        while True:
            for arm in motions:
                await self.free(arm)
            if not self._needs_yes:
                return
            question = await self._ask(
                lambda: Question.about(self._own_cell, motions, begun=begun) if self._needs_yes else None
            )
            if question is not None and question.refused:
                raise Vetoed(*motions)
            if not any(self.forbids(arm) for arm in motions):
                return

    async def choose(self, goals: Sequence[GoalOffer]) -> int:
        """Return which of these goals is next, see ``Cell.choose``."""
        self._offers, self._goal_begins = True, False
        question = await self._ask(
            lambda: None if self.level is Level.AUTONOMOUS else Question.of(self._own_cell, goals)
        )
        return 0 if question is None else question.chosen

    async def _ask(self, about: Callable[[], Question | None]) -> Question | None:
        """Ask once nothing else is being asked; return the answered question, None if it need not be asked by then."""
        while self._question is not None:
            await self._question.answered.wait()
        self._question = question = about()
        if question is not None:
            self._asked += 1
            try:
                await question.answered.wait()
            finally:  # a cancelled script withdraws its question; else the clock would stay paused
                self._answer(question)
        return question

    async def free(self, arm: str) -> None:
        """Return once the arm may be used."""
        while self.forbids(arm):
            await self.changed()

    def forbids(self, arm: str) -> bool:
        """Return whether the arm is stopped or in the person's hands."""
        return self.stopped or arm in self._lending.arms

    @property
    def _needs_yes(self) -> bool:
        return self.level is Level.MOTIONS or (self.level is Level.GOALS and self._goal_begins)

    def _must_wait(self, question: Question | None) -> bool:
        """Return whether a question still waits for an answer at the present level."""
        return self.level is not Level.AUTONOMOUS and (self._needs_yes or (question is not None and question.of_goals))

    # a script beside the agent

    async def serve(self, cell: Cell) -> None:
        """Carry out what the person asks for, beside the agent, until cancelled.

        Raises:
            EmergencyStop: the person ended the trial.
        """
        del cell  # the agent's; a person moves arms below any compensation
        async with trio.open_nursery() as nursery:
            while True:
                if not self._paced:
                    self._listen()
                    self._show()
                if self.ended:
                    raise EmergencyStop(self.ended)
                if self._robot is not None:
                    self._lending.begin(nursery, self._own_cell, self._robot)
                with trio.move_on_after(math.inf if self._paced else TICK_S):
                    await self.changed()

    async def work(self, cell: Cell, arms: Iterable[str]) -> None:
        """Let the person do the whole task with these arms, until they say that it is done.

        Args:
            cell: the agent's, compensated or not.
            arms: names.
        """
        self._works = True
        self.hands = {arm: Hand(cell, arm) for arm in arms}
        try:
            async with trio.open_nursery() as nursery:
                for hand in self.hands.values():
                    nursery.start_soon(hand.follow)
                await self._done.wait()
                nursery.cancel_scope.cancel()
        finally:
            self.latencies_s += [one for hand in self.hands.values() for one in hand.latencies_s]
            self.hands, self._works = {}, False

    # what the person asks for

    def note(self, event: Mapping[str, object]) -> None:
        """Note an event of the cell's log."""
        self._goal_begins |= event["name"] == self._noun and not self._offers

    def _listen(self) -> bool:
        """Process the new wishes; return whether there were any."""
        said = list(self._hear())
        for one in said:
            self._take_in(one)
        return bool(said)

    def _take_in(self, said: Said) -> None:  # noqa: PLR0912  a wish each
        hand, told = self.hands.get(said.arm), {"arm": said.arm} if said.arm else {}
        match said.wish:
            case Wish.NO if self._question is not None and not self._question.may_refuse:
                return
            case Wish.YES | Wish.NO | Wish.ANOTHER if self.asks and said.value in (None, self._asked):
                told["words"] = self._take_answer(said.wish)
            case Wish.STOP:
                self._stop("")
            case Wish.GO_ON:
                self.stopped = False
                for lent in self.hands.values():
                    lent.go_on()
            case Wish.EMERGENCY:
                self._stop(said.value or "a person pressed the emergency stop")
            case Wish.LEFT if self.needed:  # nobody is left to hold an arm or to confirm a motion
                self._stop("")
            case Wish.TAKE if not self._works:
                self._lending.take(said.arm)
            case Wish.RETURN if self._lending.may_return(said.arm):
                self._lending.give_back(said.arm)
            case Wish.HOLD if hand is not None and not self.stopped:
                hand.hold(said.value, said.at_s, said.source)
            case Wish.RELEASE if hand is not None:
                hand.release(said.source)
            case Wish.JAW if hand is not None and not self.stopped:
                hand.open_jaws(said.value, anew=not said.source)
                told["share"] = said.value
            case Wish.LEVEL:
                self.level, told["level"] = said.value, said.value.value
                if not self._must_wait(self._question):
                    self._answer(self._question)
            case Wish.SPEED if self._paced:
                self.speed, self._due_s = said.value, math.nan
            case Wish.PAUSE if self._paced:
                self.paused = said.value
            case Wish.STEP if self._paced:
                self.paused, self._steps = True, round(said.value / TICK_S)
            case Wish.DONE if self._works:
                self._done.set()
            case _:
                return
        streamed = said.wish in STREAMED or (said.wish is Wish.JAW and said.source)
        if self.cell is not None and not streamed:
            self.cell.log.event("person", wish=said.wish.name, **told)
        self.tell()

    def _take_answer(self, answer: Wish) -> str:
        """Let what the page shows begin, refuse it, or show another goal; a yes to the one before then counts no more.

        Returns:
            What was shown, in words.
        """
        question = self._question
        assert question is not None  # while it asks
        words = question.words
        if answer is Wish.YES:
            self._goal_begins = False
            self._answer(question)
        elif answer is Wish.NO:
            question.refused = True
            self._answer(question)
        elif len(question.choices) > 1:
            question.turn_over()
            self._asked += 1
        return words

    def _stop(self, why_ended: str) -> None:
        """Brake all arms; if a reason is given, end the trial too."""
        self.stopped, self.ended = True, why_ended or self.ended
        for hand in self.hands.values():
            hand.stop()
        if self.cell is not None:
            for arm in self.cell.arms:
                self.cell.robot.hold(arm, reason=StoppedByPerson(arm))

    @property
    def needed(self) -> bool:
        """Return whether the trial depends on the person."""
        return self._works or self.level is not Level.AUTONOMOUS or bool(self._lending.arms)

    def _answer(self, question: Question | None) -> None:
        if question is not None and question is self._question:
            self._question = None
            question.answered.set()

    # implements trocar.console.lending.Desk

    async def changed(self) -> None:
        """Return at the next wish of the person, or the next change of an arm's state."""
        await self._changed.wait()

    def tell(self) -> None:
        """Wake everybody who waits for a change."""
        changed, self._changed = self._changed, trio.Event()
        changed.set()

    # state, for the page

    @property
    def now_s(self) -> float:
        """Return the time on the cell's clock; 0 before the first trial."""
        return 0.0 if self.cell is None else self.cell.clock.now_s()

    @property
    def standing(self) -> Standing:
        """Return the console's state for the page."""
        hands: dict[str, Any] = {}
        for arm, hand in self.hands.items():
            tip = hand.tip
            hands[arm] = None if hand.held else (tip.translation_m, tip.rotation.as_quaternion())
        refused = next((hand.refused for hand in self.hands.values() if hand.refused), "")
        speed = self.speed if self._paced else None
        running = {} if self._robot is None else {arm: m for arm, m in self._robot.running.items() if arm not in hands}
        now = Standing("", level=self.level, speed=speed, stopped=self.stopped, works=self._works, hands=hands)
        now = replace(now, paths=self._paths.of(self._own_cell, running) if running else {})
        if self.ended:
            return replace(now, words=f"Ended: {self.ended}", colour=BAD)
        if self.stopped:
            return replace(now, words="Stopped: arms stay where they are until you press Go on", colour=BAD)
        if self.hands:
            words = refused or f"In your hands: {', '.join(self.hands)}. Drag the handle or press keys; let go to stop"
            return replace(now, words=words, colour=WAITS if refused else GOOD)
        if self._lending.arms:
            return replace(now, words="Brings an arm to rest, or its jaws back to where they were", colour=WAITS)
        if (question := self._question) is not None:
            words = f"Waits for your yes: {question.words}"
            asked = replace(now, asks=True, question=self._asked, choices=len(question.choices), ghosts=question.ghosts)
            return replace(asked, words=words, colour=WAITS, may_refuse=question.may_refuse)
        return replace(now, words="Paused" if self.paused else "Runs", colour=WAITS if self.paused else GOOD)
