"""How a script's end ends the cell: in time, too late, by failure, by Ctrl-C."""

import numpy as np
import pytest
import trio

from simulated import PAPER, ideal_session, joints_at, scene_of, standing
from trocar.motion import rest_to_rest
from trocar.sim.cell import SimulatedCell


@pytest.fixture
def cell():
    return SimulatedCell(ideal_session(), scene_of(standing(0)), np.random.default_rng(0))


def assert_holding(cell):
    """Both arms rest where they are commanded, however long one waits."""
    before = {arm: cell.robot.read(arm).q for arm in cell.session.arms}
    assert cell.run(lambda: trio.sleep(0.5), 5.0)
    for arm, q in before.items():
        assert np.array_equal(cell.robot.read(arm).q, q)
        assert np.abs(cell.world.joints(arm) - q).max() < 1e-3


async def move_both(cell):
    goals = {"psm1": joints_at("psm1", (-0.02, 0.0, 0.07)), "psm2": joints_at("psm2", (-0.06, 0.0, 0.07))}
    async with trio.open_nursery() as nursery:
        for arm, goal in goals.items():
            nursery.start_soon(cell.robot.move, arm, rest_to_rest(cell.robot.read(arm).q, goal, PAPER).stretched(3))


def test_the_clock_is_the_physics(cell):
    async def script():
        await trio.sleep(0.37)
        assert trio.current_time() == pytest.approx(cell.world.time_s, abs=1e-9)

    assert cell.run(script, 5.0)
    assert cell.world.time_s == pytest.approx(0.37, abs=0.011)


def test_a_spent_budget_ends_the_script_and_holds_the_arms(cell):
    start = cell.robot.read("psm1").q
    assert not cell.run(lambda: move_both(cell), 0.4)
    assert cell.world.time_s == pytest.approx(0.4, abs=0.011)
    assert np.abs(cell.robot.read("psm1").q - start).max() > 1e-3
    assert_holding(cell)


def test_a_failing_script_cancels_the_others_holds_the_arms_and_is_named(cell):
    done = []

    async def other():
        try:
            await move_both(cell)
            done.append("moved")
        finally:
            done.append("cancelled")

    async def failing():
        await trio.sleep(0.3)
        raise ZeroDivisionError("of a script")

    async def script():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(other)
            nursery.start_soon(failing)

    with pytest.raises(ZeroDivisionError, match="of a script"):
        cell.run(script, 10.0)
    assert done == ["cancelled"]
    assert_holding(cell)


def test_an_interruption_comes_out_as_one_even_beside_another_failure(cell):
    async def interrupted():
        raise KeyboardInterrupt

    async def failing():
        raise ValueError("beside it")

    async def script():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(failing)
            nursery.start_soon(interrupted)

    with pytest.raises(KeyboardInterrupt):
        cell.run(script, 10.0)
