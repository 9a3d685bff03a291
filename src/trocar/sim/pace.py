"""How fast the clock of a simulated cell runs: as fast as possible, with the wall clock, or stepped from outside."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Protocol

import trio
from trio._core import _run
from trio.testing import wait_all_tasks_blocked

from trocar.errors import InvalidValue
from trocar.robots.driver import TICK_S

if TYPE_CHECKING:
    from trocar.cell import Cell
    from trocar.sim.laboratory import SimLaboratory

Script = Callable[["Cell"], Awaitable[Any]]


def repeat_scheduling() -> None:
    """Make scripts that are due at the same time run in the same order in every run of a trial.

    Trio reverses them at random on purpose, and whichever takes an image first draws the camera's noise first.
    """
    # These switches are private, and used only here; Hypothesis makes trio deterministic with them too. No public
    # interface orders tasks: an instrument (`trio.abc.Instrument`) sees each task become due but cannot move it, a
    # guest run (`trio.lowlevel.start_guest_run`) hands over whole batches, and one event or cancellation wakes several
    # tasks whatever their checkpoints do. A test fails if trio renames the switches.
    _run._ALLOW_DETERMINISTIC_SCHEDULING = True  # type: ignore[misc]
    _run._r.seed(0)


class Pace(Protocol):
    """How fast a cell's clock runs."""

    async def wait(self, now_s: float) -> None:
        """Return when the tick that begins at this time of the cell's clock may begin."""
        ...


class RealTime:
    """A pace no faster than the wall clock.

    Args:
        speed: seconds of the cell per second of the wall clock.
        max_late_s: a cell that is late by up to this much catches up; a later one continues without catching up.

    Attributes:
        ticks: number of ticks that have begun.
        late_ticks: number of ticks that began late by a tick or more.
        latest_s: greatest lateness, on the wall clock.
    """

    def __init__(self, speed: float = 1.0, max_late_s: float = math.inf):
        if not (math.isfinite(speed) and speed > 0):
            raise InvalidValue("the speed of a real-time clock", speed, "give a number above 0")
        self._speed, self._max_late_s, self._origin_s = speed, max_late_s, math.nan
        self.ticks, self.late_ticks, self.latest_s = 0, 0, 0.0

    async def wait(self, now_s: float) -> None:
        """Sleep until the wall clock has caught up."""
        if math.isnan(self._origin_s):
            self._origin_s = time.perf_counter() - now_s / self._speed
        due_s = self._origin_s + now_s / self._speed
        left_s = due_s - time.perf_counter()
        if left_s < -self._max_late_s:
            self._origin_s -= left_s
        if left_s > 0:
            await trio.to_thread.run_sync(time.sleep, left_s)  # in a thread, because trio's own clock is the cell's
        late_s = time.perf_counter() - due_s
        self.ticks, self.latest_s = self.ticks + 1, max(self.latest_s, late_s)
        self.late_ticks += late_s >= TICK_S / self._speed


class Stepping:
    """A simulated cell that is stepped from outside: by Gymnasium, a server, or a person at a console.

    The cell and its scripts run in a thread, but only while :meth:`step` waits for it, so that the outcome does not
    depend on the machine. Use it as a context manager.

    Example:
        with build_cell("peg-transfer").stepping() as cell:
            cell.call(lambda c: c.robot.jaw("psm1", 0.5))
            cell.step(0.2)
            print(cell.cell.robot.read("psm1"))

    Args:
        laboratory: the laboratory of the cell.
        script: script that runs beside the calls; None: none.
        budget_s: budget on the cell's clock.

    Attributes:
        cell: the cell, to read from between two steps.
        over: whether the script has ended or the budget is spent.
    """

    def __init__(self, laboratory: SimLaboratory, script: Script | None = None, budget_s: float = math.inf):
        self._laboratory, self._script, self._budget_s = laboratory, script, budget_s
        self._may_tick: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._at_rest: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._calls: queue.SimpleQueue[Script] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._granted, self._left, self.over, self.cell = 0, False, False, laboratory.cell
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Stepping:
        self._thread.start()
        self._at_rest.get()
        return self

    def __exit__(self, *_: object) -> None:
        if not self.over:
            self._may_tick.put(0)
        self._thread.join()

    def call(self, script: Script) -> None:
        """Start a script, such as a motion, at the next tick."""
        self._calls.put(script)

    def step(self, seconds: float = TICK_S) -> None:
        """Advance the cell by this time, in whole ticks; return when it waits again.

        Raises:
            BaseException: whatever a script raised.
        """
        if not self.over:
            self._may_tick.put(max(1, round(seconds / TICK_S)))
            self._at_rest.get()
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    async def wait(self, now_s: float) -> None:
        """Tell the outside program that the cell waits, and wait for its go-ahead."""
        del now_s
        if self._left:
            return
        if self._granted:
            self._granted -= 1
            return
        self._at_rest.put(None)
        ticks = self._may_tick.get()  # nothing else runs in this thread until the outside program steps on
        if not ticks:
            self._left = True  # the last ticks, in which the arms come to rest, wait for nobody
            self._laboratory.end()
        self._granted = ticks - 1
        while not self._calls.empty():
            self._laboratory.start_soon(self._calls.get())
            await wait_all_tasks_blocked()  # what it starts, such as a motion, is part of this tick

    def _run(self) -> None:
        try:
            self._laboratory.run(self._script or _for_ever, self._budget_s, pace=self)
        except BaseException as error:
            self._error = error
        self.over = True
        self._at_rest.put(None)


async def _for_ever(cell: Cell) -> None:
    del cell
    await trio.sleep_forever()
