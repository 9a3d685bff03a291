"""Scripts side by side."""

import pytest
import trio
from trio.testing import MockClock

from trocar.robots.concurrency import Pending, first_of, with_helpers


def run(script):
    return trio.run(script, clock=MockClock(autojump_threshold=0))


def test_what_a_helper_computes_is_taken_once():
    pending = Pending()

    async def compute():
        await trio.sleep(1.0)
        return 7

    async def script(helpers):
        pending.start(helpers, compute)
        return await pending.take(), await pending.take()

    assert run(lambda: with_helpers(script)) == (7, None)


def test_nobody_waits_for_what_nobody_asked():
    async def script():
        return await Pending().take()

    assert run(script) is None


def test_an_error_of_the_script_goes_on_as_it_is_and_ends_the_helpers():
    ended = []

    async def helper():
        try:
            await trio.sleep_forever()
        finally:
            ended.append(True)

    async def script(helpers):
        helpers.start_soon(helper)
        await trio.sleep(0.1)
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"):
        run(lambda: with_helpers(script))
    assert ended == [True]


def test_a_script_ends_when_its_helpers_have():
    async def script():
        async def quick(helpers):
            helpers.start_soon(trio.sleep, 2.0)
            return trio.current_time()

        begun_s = await with_helpers(quick)
        return trio.current_time() - begun_s

    assert run(script) == 2.0


def test_the_first_event_is_enough():
    async def script():
        late, early = trio.Event(), trio.Event()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(set_after, early, 0.5)
            begun_s = trio.current_time()
            await first_of(late, early)
            return trio.current_time() - begun_s

    async def set_after(event, seconds):
        await trio.sleep(seconds)
        event.set()

    assert run(script) == 0.5
