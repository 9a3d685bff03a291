"""Two arms that keep pace."""

from math import inf
from types import SimpleNamespace

import trio
from trio.testing import MockClock

from trocar.log import CellLog
from trocar.tasks.peg_transfer.agents.pace import Pace

PATIENCE_S = 2.0


def kept(script):
    """Run a script of two arms' pace; return the log."""
    log = CellLog(trio.current_time)

    async def run():
        await script(Pace(SimpleNamespace(log=log), ("a", "b"), PATIENCE_S))

    trio.run(run, clock=MockClock(autojump_threshold=0))
    return log


def test_an_arm_waits_until_the_other_has_come_as_far():
    async def script(pace):
        begin_s = trio.current_time()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(come_later, pace)
            await pace.wait("a", 1.0)
            assert trio.current_time() - begin_s == 0.7

    async def come_later(pace):
        await trio.sleep(0.3)
        pace.come("b", 0.5)
        await trio.sleep(0.4)
        pace.come("b", 1.0)

    (span,) = kept(script).spans
    assert (span.arm, span.name) == ("a", "waiting")


def test_an_arm_that_is_behind_does_not_wait():
    async def script(pace):
        pace.come("b", 3.0)
        await pace.wait("a", 2.5)

    assert kept(script).spans == []


def test_patience_ends():
    async def script(pace):
        begin_s = trio.current_time()
        await pace.wait("a", 1.0)
        assert trio.current_time() - begin_s == PATIENCE_S

    kept(script)


def test_one_that_has_done_keeps_nobody():
    async def script(pace):
        pace.come("b")
        await pace.wait("a", 1e9)
        pace.come("b", inf)

    assert kept(script).spans == []
