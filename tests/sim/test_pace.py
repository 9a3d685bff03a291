"""A cell that runs no faster than the wall's clock, here a number; and scripts that go on in the same order."""

import inspect
from types import SimpleNamespace

import pytest
import trio

from trocar.sim import pace
from trocar.sim.pace import RealTime, repeat_scheduling


@pytest.fixture
def wall(monkeypatch):
    wall = SimpleNamespace(now_s=1000.0, slept=[])

    def sleep(seconds):
        wall.slept.append(seconds)
        wall.now_s += seconds

    monkeypatch.setattr(pace, "time", SimpleNamespace(perf_counter=lambda: wall.now_s, sleep=sleep))
    return wall


@pytest.mark.parametrize(("speed", "factor"), [({}, 1.0), ({"speed": 0.5}, 0.5), ({"speed": 4.0}, 4.0)])
def test_it_sleeps_until_the_wall_has_caught_up_and_not_where_that_is_ahead(wall, speed, factor):
    real = RealTime(**speed)
    trio.run(real.wait, 7.0)
    assert wall.slept == [], "the clock begins with the first tick, whatever it shows"
    trio.run(real.wait, 7.5)
    assert wall.slept == pytest.approx([0.5 / factor])
    wall.now_s += 0.1 / factor  # computing
    trio.run(real.wait, 7.75)
    assert wall.slept[1:] == pytest.approx([0.15 / factor])
    wall.now_s += 1.0 / factor
    trio.run(real.wait, 8.0)
    assert len(wall.slept) == 2, "it is behind"
    trio.run(real.wait, 9.0)
    assert wall.slept[2:] == pytest.approx([0.25 / factor]), "and catches up"


def test_a_cell_that_was_stopped_for_long_goes_on_without_a_hurry(wall):
    real = RealTime(max_late_s=0.1)
    trio.run(real.wait, 0.0)
    wall.now_s += 5.0
    trio.run(real.wait, 0.01)
    trio.run(real.wait, 0.02)
    assert wall.slept == pytest.approx([0.01])
    wall.now_s += 0.1
    trio.run(real.wait, 0.03)
    trio.run(real.wait, 0.13)
    assert wall.slept[1:] == pytest.approx([0.01]), "it catches up with a little"


def order_of_twenty():
    order = []

    async def task(number, start):
        await start.wait()
        for _ in range(3):
            await trio.lowlevel.checkpoint()
            order.append(number)

    async def main():
        start = trio.Event()
        async with trio.open_nursery() as nursery:
            for number in range(20):
                nursery.start_soon(task, number, start)
            start.set()

    repeat_scheduling()
    trio.run(main)
    return order


def test_scripts_that_are_due_together_go_on_in_the_same_order_every_time():
    first = order_of_twenty()
    kept = [order_of_twenty() for _ in range(6)]  # moves the next one's tasks to other places of the memory
    assert all(order == first for order in kept)


def test_trio_still_has_the_private_switches_that_keep_the_order():
    """If this fails, trio has renamed them: see ``repeat_scheduling``, and whether there is a public way by now."""
    scheduler = inspect.getsource(trio._core._run.unrolled_run)
    assert "if _ALLOW_DETERMINISTIC_SCHEDULING:" in scheduler and "_r.shuffle(batch)" in scheduler
    assert "batch.sort(key=lambda t: t._counter)" in scheduler, "by the order in which tasks were started"
