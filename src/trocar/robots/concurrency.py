"""Scripts that run side by side, and computations while an arm still moves."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Generic

import trio

from trocar.cell import Result


class Pending(Generic[Result]):
    """A result that a helper computes; None if it found nothing, or was never started."""

    def __init__(self) -> None:
        self._value: Result | None = None
        self._done: trio.Event | None = None

    def start(self, helpers: trio.Nursery, compute: Callable[[], Awaitable[Result | None]]) -> None:
        """Compute the result in parallel."""
        self._done = trio.Event()
        helpers.start_soon(self._find, compute, self._done)

    async def _find(self, compute: Callable[[], Awaitable[Result | None]], done: trio.Event) -> None:
        try:
            self._value = await compute()
        finally:
            done.set()

    def put(self, value: Result | None) -> None:
        """Set a result that was computed elsewhere."""
        self._value, self._done = value, None

    async def take(self) -> Result | None:
        """Return the result once it is available; a second call returns None."""
        if self._done is not None:
            await self._done.wait()
        value, self._value = self._value, None
        return value


async def with_helpers(script: Callable[[trio.Nursery], Awaitable[Result]]) -> Result:
    """Run a script that may start helpers; return its result when all have ended.

    Helpers compute and must not raise. An exception of the script cancels them and is raised again.
    """
    failure: Exception | None = None
    results: list[Result] = []
    async with trio.open_nursery() as helpers:
        try:
            results.append(await script(helpers))
        except Exception as error:
            failure = error
            helpers.cancel_scope.cancel()
    if failure is not None:
        raise failure
    return results[0]


async def together(*scripts: Callable[[], Awaitable[Any]]) -> None:
    """Run scripts side by side; return when all have ended.

    The first exception of a script cancels the others and is raised again.
    """
    failures: list[Exception] = []

    async def run(script: Callable[[], Awaitable[Any]]) -> None:
        try:
            await script()
        except Exception as error:
            failures.append(error)
            nursery.cancel_scope.cancel()

    async with trio.open_nursery() as nursery:
        for script in scripts:
            nursery.start_soon(run, script)
    if failures:
        raise failures[0]


async def first_of(*events: trio.Event) -> None:
    """Return when one of several events has happened."""

    async def wait(event: trio.Event) -> None:
        await event.wait()
        nursery.cancel_scope.cancel()

    async with trio.open_nursery() as nursery:
        for event in events:
            nursery.start_soon(wait, event)


def cause_of(error: BaseException) -> BaseException:
    """Return the exception inside (nested) groups: an interruption such as Ctrl-C if there is one, else the first."""
    errors = [error]
    for one in errors:  # the list grows by what is in each group
        errors.extend(one.exceptions if isinstance(one, BaseExceptionGroup) else ())
    leaves = [one for one in errors if not isinstance(one, BaseExceptionGroup)]
    return next((leaf for leaf in leaves if not isinstance(leaf, Exception)), leaves[0])
