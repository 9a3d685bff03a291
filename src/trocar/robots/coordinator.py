"""Coordination of several arms in one space: who moves when, who may be where, and who waits for whom."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from typing import Any

import trio

from trocar.cell import Cell, MotionResult
from trocar.errors import MotionRefused, UnknownName
from trocar.geometry import SE3
from trocar.geometry.capsules import Capsules
from trocar.log import timed
from trocar.robots.concurrency import first_of
from trocar.robots.traffic import NEVER, Departure, Traffic
from trocar.trajectory import Trajectory


class Blocked(MotionRefused):
    """The motion of an ``arm`` cannot start because another arm is in the way, and waiting does not help."""

    def __init__(self, arm: str):
        super().__init__(f"arm {arm!r} has no room to move, and waiting does not help", arm=arm)


class _Signal:
    """Wakes everybody who waits for something to change."""

    def __init__(self) -> None:
        self.event = trio.Event()

    def notify(self) -> None:
        event, self.event = self.event, trio.Event()
        event.set()


@dataclass(frozen=True)
class Margins:
    """Distances that the coordinator keeps between arms, and how long arms wait.

    Attributes:
        margin_m: distance kept between two arms, and between what they hold.
        min_margin_m: the same for an arm that departs, or would otherwise be stuck.
        patience_s: an arm that could not move for this long gets ``Blocked``.
        check_budget_s: computing time declared for checking a motion against the other arms.
    """

    margin_m: float = 4e-3
    min_margin_m: float = 2e-3
    patience_s: float = 3.0
    check_budget_s: float = 0.02


@dataclass
class _Turn:
    """The state of one arm's script, as the others see it.

    Attributes:
        waiting: whether it waits for another arm to do something else.
        pressed: set when it is asked to give way.
        step: last step of the task that it has reached.
        at_work: whether joint decisions wait for its request.
    """

    waiting: bool = False
    pressed: trio.Event = field(default_factory=trio.Event)
    step: float = 0.0
    at_work: bool = True


@dataclass
class _Reservation:
    """A space for one arm at a time; arms get it in the order in which they asked."""

    free: trio.Semaphore = field(default_factory=lambda: trio.Semaphore(1))
    holder: str | None = None


@dataclass
class _Request:
    """What one arm asks in a joint decision, and the answer."""

    asked: Any
    answer: Any = None
    taken: bool = False
    answered: trio.Event = field(default_factory=trio.Event)


class Coordinator:
    """Coordinates arms that share a space; the scripts of all arms share one coordinator.

    * :meth:`admit` and :meth:`run`: each motion is checked against the other arms, then announced. An arm whose motion
      is not free now waits at rest: as long as the other arm's announced motion requires, or until that arm does
      something else. If two arms would wait for each other, one gets ``Blocked``, and its script must do something
      else: the one whose jaws are empty, else the one that has waited longer. An arm that has waited for longer than
      ``patience_s`` gets ``Blocked`` too.
    * :meth:`reserve` and :meth:`release`: a space for one arm at a time.
    * :meth:`reached` and :meth:`wait_for_others`: arms that go back and forth between the same places keep pace.
    * :meth:`decide_together`: one decision for all arms, once each has asked.

    Args:
        cell: the laboratory.
        arms: names of those that take part. The others must rest out of the way; the robot's guard still checks them.
        margins: distances to keep, and waiting times.

    Raises:
        UnknownName: an arm is not in the cell.
    """

    def __init__(self, cell: Cell, arms: Sequence[str], margins: Margins | None = None):
        for name in arms:
            if name not in cell.arms:
                raise UnknownName("arm", name, cell.arms)
        self._cell, self._margins = cell, margins or Margins()
        self._traffic = Traffic(cell, arms, self._margins.min_margin_m)
        self._lanes, self._turns = self._traffic.lanes, {name: _Turn() for name in arms}
        self._spaces: dict[str, _Reservation] = {}
        self._requests: dict[str, _Request] = {}
        self._motions, self._progress, self._asking = _Signal(), _Signal(), _Signal()

    @property
    def alone(self) -> bool:
        """Return whether only one arm takes part."""
        return len(self._turns) == 1

    def carry(self, arm: str, held: Capsules | None) -> None:
        """Record what an arm holds in its jaws, as capsules in the frame of its tip; None: nothing."""
        self._lanes[arm].held = held
        self._motions.notify()

    def stands(self, arm: str, T_world_base: SE3) -> None:
        """Record a better estimate of an arm's base than the registered one."""
        self._lanes[arm].T_world_base = T_world_base

    def carries(self, arm: str) -> bool:
        """Return whether an arm was recorded as holding something."""
        return self._lanes[arm].held is not None

    # Motions.

    async def admit(
        self,
        arm: str,
        motion: Trajectory,
        *,
        jaw_rad: float = 0.0,
        margin_m: float | None = None,
        contact_s: tuple[float, float] = NEVER,
        departure: Departure | None = None,
        waits: bool = True,
    ) -> None:
        """Wait until a motion is free, then announce it; the caller must ``run`` it next.

        Args:
            arm: at rest where the motion starts.
            motion: of its joints.
            jaw_rad: widest opening of the jaws on the way.
            margin_m: distance to keep from other arms; None: the default.
            contact_s: interval of the motion in which the jaws may touch what the other arm holds.
            departure: how the arm gets away from where the motion ends; the other arm must leave room for that too.
            waits: whether to wait for the other arm to do something else, if its announced motion leaves no room.

        Raises:
            Blocked: waiting does not help.
        """
        lane, clock = self._lanes[arm], self._cell.clock
        lane.jaw_rad = jaw_rad
        margin = self._margins.margin_m if margin_m is None else margin_m
        deadline_s = clock.now_s() + self._margins.patience_s
        while (delay := await self._checked(arm, motion, margin, contact_s, departure)) != 0.0:
            with self._cell.log.span(arm, "waiting"):
                if delay is not None:
                    await clock.sleep(delay)
                elif not waits:
                    raise Blocked(arm)
                else:
                    await self._wait_for_change(arm, deadline_s)
        lane.announced, lane.departure = motion, departure
        self._motions.notify()

    async def run(self, arm: str, motion: Trajectory) -> MotionResult:
        """Run a motion that was admitted."""
        try:
            with self._cell.log.span(arm, "motion"):
                return (await self._cell.robot.move({arm: motion}))[arm]
        finally:
            self._lanes[arm].announced = None
            self._motions.notify()

    async def _checked(
        self, arm: str, motion: Trajectory, margin_m: float, contact_s: tuple[float, float], departure: Departure | None
    ) -> float | None:
        """Return the delay of a motion (see ``Traffic``), timed on the cell's clock; 0 if only one arm takes part.

        The declared time passes before the check, because the check must see the latest state of the other arms, and
        nothing may happen between the check and the announcement.
        """
        if self.alone:
            return 0.0
        budget_s = self._margins.check_budget_s
        with self._cell.log.span(arm, "planning"):
            await self._cell.clock.compute(lambda: None, budget_s)
        delay, seconds = timed(lambda: self._traffic.delay_s(arm, motion, margin_m, contact_s, departure))
        self._cell.log.compute("traffic", seconds, budget_s)
        return delay

    async def _wait_for_change(self, arm: str, deadline_s: float) -> None:
        turn, left_s = self._turns[arm], deadline_s - self._cell.clock.now_s()
        if left_s <= 0:
            raise Blocked(arm)
        standing = [name for name, other in self._turns.items() if name != arm and other.waiting]
        if standing and not self.carries(arm) and any(map(self.carries, standing)):
            raise Blocked(arm)
        for name in standing:
            self._turns[name].pressed.set()
        changed, turn.waiting, turn.pressed = self._motions.event, True, trio.Event()
        try:
            with trio.move_on_after(left_s):
                await first_of(changed, turn.pressed)
        finally:
            turn.waiting = False
        if turn.pressed.is_set():
            raise Blocked(arm)

    # Spaces.

    def try_reserve(self, arm: str, space: str) -> bool:
        """Reserve a space if it is free; return whether the arm has it."""
        place = self._spaces.setdefault(space, _Reservation())
        if place.holder is None and place.free.value:
            place.free.acquire_nowait()
            place.holder = arm
        return place.holder == arm

    async def reserve(self, arm: str, space: str) -> None:
        """Reserve a space, or wait until the arms that asked before have left it."""
        if self.try_reserve(arm, space):
            return
        place = self._spaces[space]
        await place.free.acquire()
        place.holder = arm

    def release(self, arm: str, space: str) -> None:
        """Release a space, if this arm holds it, to the arm that waits for it."""
        place = self._spaces.get(space)
        if place is not None and place.holder == arm:
            place.holder = None
            place.free.release()

    # Pace.

    def reached(self, arm: str, step: float = inf) -> None:
        """Note that an arm has reached a step of the task; by default, that it has finished."""
        self._turns[arm].step = step
        self.progress()

    def progress(self) -> None:
        """Wake the scripts that wait for other arms to make progress."""
        self._progress.notify()

    async def progressed(self) -> None:
        """Return when an arm has made progress."""
        await self._progress.event.wait()

    async def wait_for_others(self, arm: str, step: float, patience_s: float) -> None:
        """Wait until all other arms have reached a step, but not longer than this."""
        others = [turn for name, turn in self._turns.items() if name != arm]
        if all(other.step >= step for other in others):
            return
        with self._cell.log.span(arm, "waiting"), trio.move_on_after(patience_s):
            while any(other.step < step for other in others):
                await self.progressed()

    # Joint decisions.

    def leave(self, arm: str) -> None:
        """Let the others decide without waiting for this arm, which stays where it is."""
        self._turns[arm].at_work = False
        self._asking.notify()

    @contextmanager
    def idle(self, arm: str) -> Iterator[None]:
        """Let the others decide without waiting for this arm until the context ends."""
        self.leave(arm)
        try:
            yield
        finally:
            self._turns[arm].at_work = True

    async def decide_together(
        self, arm: str, asked: Any, decide: Callable[[Mapping[str, Any]], Awaitable[Mapping[str, Any]]]
    ) -> Any:
        """Ask, wait until all arms at work have asked, and return this arm's part of the joint answer.

        Args:
            arm: the arm that asks.
            asked: its request, passed to ``decide``.
            decide: returns the answers by arm, given all requests by arm; only one arm's function is called.
        """
        request = self._requests[arm] = _Request(asked)
        self._asking.notify()
        with self._cell.log.span(arm, "waiting"):
            while not request.taken and not self._all_asked():
                await first_of(self._asking.event, request.answered)
        if not request.taken and arm == min(self._requests):
            requests, self._requests = self._requests, {}
            for other in requests.values():
                other.taken = True
            self._asking.notify()
            answers = await decide({name: other.asked for name, other in requests.items()})
            for name, other in requests.items():
                other.answer = answers[name]
                other.answered.set()
        else:
            with self._cell.log.span(arm, "planning"):
                await request.answered.wait()
        return request.answer

    def _all_asked(self) -> bool:
        return all(name in self._requests for name, turn in self._turns.items() if turn.at_work)
