"""Progress of long work: what is happening now, how much is done, and the time left.

A terminal shows bars; a file or a pipe gets a line every ten seconds; ``--quiet`` shows nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from threading import Event, Thread
from typing import TYPE_CHECKING

from trocar.cli.terminal import beside
from trocar.counting import Tick, untold

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Task

SPEED_FROM_S = 600.0
"""The time left is estimated from the speed over this many past seconds; a trial takes minutes."""
FIRST_S, EVERY_S = 0.8, 10.0
"""Time before the first line, and between two lines."""


@contextmanager
def progress() -> Iterator[Tick]:
    """Show the progress of work; yield the function to call with it."""
    console = beside()
    if console.quiet:
        yield untold
        return
    from rich.progress import (  # takes a tenth of a second, and help does not need it
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    shown = Progress(
        TextColumn("{task.description}", markup=False),
        *bar,
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=SPEED_FROM_S,
    )
    tasks: dict[str, Task] = {}

    def tick(work: str, done: int, total: int | None, now: str = "") -> None:
        if work not in tasks:
            number = shown.add_task(work, total=total, completed=done)
            tasks[work] = next(task for task in shown.tasks if task.id == number)
        tasks[work] = tasks.pop(work)  # the last one is the present work
        shown.update(tasks[work].id, completed=done, total=total, description=now or work)

    with shown, _lines(console, tasks):
        yield tick


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Show that something is running whose duration is unknown."""
    with progress() as tick:
        tick(what, 0, None)
        yield


def line_of(work: str, task: Task) -> str:
    """Return a line with the progress of a piece of work, the time taken and the time left."""
    said = [work if task.total is None else f"{work}: {task.completed:.0f} of {task.total:.0f}"]
    said += [task.description] if task.description != work else []
    said.append(f"{timedelta(seconds=round(task.elapsed or 0.0))} so far")
    if task.time_remaining:
        said.append(f"about {timedelta(seconds=round(task.time_remaining))} left")
    return ", ".join(said)


@contextmanager
def _lines(console: Console, tasks: dict[str, Task]) -> Iterator[None]:
    """If there is no terminal, write a line about the last task every few seconds."""
    ended = Event()

    def tell() -> None:
        wait_s = FIRST_S
        while not ended.wait(wait_s):
            if tasks:
                console.print(line_of(*list(tasks.items())[-1]), soft_wrap=True, highlight=False)
                wait_s = EVERY_S

    teller = Thread(target=tell, daemon=True)
    if not console.is_terminal:
        teller.start()
    try:
        yield
    finally:
        ended.set()
        if teller.is_alive():
            teller.join()
