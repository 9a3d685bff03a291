"""Progress of long work: what is happening now, how much is done, and the time left.

A terminal shows bars; if stderr is a file or a pipe, there is a line every ten seconds; with ``--quiet``, nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from trocar.cli.terminal import beside
from trocar.counting import Tick, untold

COLUMNS = (
    TextColumn("{task.description}"),
    BarColumn(),
    MofNCompleteColumn(),
    TimeElapsedColumn(),
    TextColumn("left"),
    TimeRemainingColumn(),
)
SPEED_FROM_S = 600.0
"""The time left is estimated from the speed over this many past seconds; a trial takes minutes."""
FIRST_S, EVERY_S = 0.8, 10.0
"""Time before the first line, and between two lines."""


class Lines:
    """Progress in plain lines.

    Args:
        clock: returns the seconds of a monotonic clock.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._work, self._now = "", ""
        self._done = self._first = 0
        self._total: int | None = None
        self._began_s = clock()

    def tick(self, work: str, done: int, total: int | None, now: str = "") -> None:
        """Note how far a piece of work has come."""
        if work != self._work:
            self._began_s, self._first = self._clock(), done
        self._work, self._done, self._total, self._now = work, done, total, now

    def line(self) -> str:
        """Return a line with how far the work has come, how long it took and how long the rest will take."""
        if not self._work:
            return ""
        took_s = self._clock() - self._began_s
        said = [self._work if self._total is None else f"{self._work}: {self._done} of {self._total}"]
        said += [self._now] if self._now else []
        said.append(f"{_clock_time(took_s)} so far")
        if self._total is not None and self._done > self._first:
            left = (self._total - self._done) / (self._done - self._first)
            said.append(f"about {_clock_time(took_s * left)} left")
        return ", ".join(said)


def _clock_time(seconds: float) -> str:
    """Return seconds as minutes and seconds, or hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


@contextmanager
def progress() -> Iterator[Tick]:
    """Show the progress of work; yield the function to call with it."""
    console = beside()
    if console.quiet:
        yield untold
    elif console.is_terminal:
        with _bars(console) as tick:
            yield tick
    else:
        with _lines(console) as tick:
            yield tick


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Show that something is running whose duration is unknown."""
    with progress() as tick:
        tick(what, 0, None)
        yield


@contextmanager
def _bars(console: Console) -> Iterator[Tick]:
    with Progress(*COLUMNS, console=console, transient=True, speed_estimate_period=SPEED_FROM_S) as shown:
        bars: dict[str, Any] = {}

        def tick(work: str, done: int, total: int | None, now: str = "") -> None:
            if work not in bars:
                bars[work] = shown.add_task(work, total=total, completed=done)
            shown.update(bars[work], completed=done, total=total, description=now or work)

        yield tick


@contextmanager
def _lines(console: Console) -> Iterator[Tick]:
    lines, ended = Lines(), Event()

    def tell() -> None:
        wait_s = FIRST_S
        while not ended.wait(wait_s):
            if line := lines.line():
                console.print(line, soft_wrap=True, markup=False, highlight=False)
                wait_s = EVERY_S

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield lines.tick
    finally:
        ended.set()
        teller.join()
