"""Motions that run, end, are cancelled, held and replaced."""

from functools import cache

import numpy as np
import pytest
import trio
from hypothesis import given, settings
from hypothesis import strategies as st

from driven import ARM, GOAL, HOME, PAPER, PlainArms, running
from trocar.cell import MotionEnd
from trocar.errors import TrocarError
from trocar.motion import plan_through, rest_to_rest
from trocar.robots import TICK_S
from trocar.trajectory import Trajectory

EXACT = 1.0 + 1e-6


def there():
    return rest_to_rest(HOME, GOAL, PAPER)


def test_a_motion_runs_to_its_end_and_says_so():
    arms = PlainArms()

    execution = arms.run(lambda: arms.robot.move({"a": there()}))["a"]
    assert execution.ended is MotionEnd.DONE and execution.done and execution.reason == ""
    assert np.abs(execution.commanded[-1, :6] - GOAL).max() < 1e-12
    assert np.allclose(np.diff(execution.times_s), TICK_S)
    assert execution.times_s[-1] == pytest.approx(np.ceil(there().duration_s / TICK_S) * TICK_S)
    assert np.array_equal(execution.commanded, execution.measured)


@cache
def winding(seed):
    """A spline through four places, planned once."""
    rng = np.random.default_rng(seed)
    points = HOME + np.cumsum(rng.uniform(-0.12, 0.12, (4, 6)) * [1, 1, 0.1, 2, 2, 2], axis=0)
    points[0] = HOME
    return plan_through(ARM, np.clip(points, ARM.lower + 0.01, ARM.upper - 0.01), PAPER).trajectory


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.02, 0.98), seed=st.integers(0, 9))
def test_a_cancelled_motion_comes_to_rest_on_its_path_within_the_limits(share, seed):
    """Also half-way through a spline that uses its limits up."""
    motion, arms, told = winding(seed), PlainArms(), []
    arms.each_tick.append(lambda: told.append(arms.robot.setpoint("a")))

    async def script():
        with trio.move_on_after(share * motion.duration_s) as scope:
            await arms.robot.move({"a": motion})
        assert scope.cancelled_caught
        return arms.robot.setpoint("a")

    at = arms.run(script)
    assert not at.moving and not at.velocity.any()
    velocity, acceleration = arms.use("a")
    assert velocity <= EXACT and acceleration <= EXACT
    assert at.path_s < motion.duration_s
    if at.on_path:
        assert all(row.on_path and np.abs(row.q - motion(row.path_s)).max() < 1e-9 for row in told)
        assert np.abs(np.array(arms.sent["a"])[5::5] - [row.q for row in told]).max() < 1e-9
        assert np.abs(at.q - motion(at.path_s)).max() < 1e-9
    else:
        assert (at.q >= ARM.lower).all() and (at.q <= ARM.upper).all()


def test_a_stop_takes_no_longer_than_the_joints_need():
    """Velocity over acceleration of the slowest joint, twice, and a tenth of a second."""
    motion, arms = there(), PlainArms()
    half = motion.duration_s / 2

    async def script():
        with trio.move_on_after(half):
            await arms.robot.move({"a": motion})
        return arms.now_s()

    alone_s = np.max(np.abs(motion(half, 1)) / PAPER.acceleration)
    assert half <= arms.run(script) <= half + 2 * alone_s + 0.15


def test_a_held_motion_returns_as_held_with_its_reason():
    arms = PlainArms()

    async def script():
        async with running(arms.robot.move, {"a": there()}) as ends:
            await trio.sleep(0.1)
            arms.robot.hold("a", reason="somebody is in the way")
            assert arms.robot.setpoint("a").moving, "braking takes time"
            await arms.robot.rest("a")
        return ends[0]["a"]

    held = arms.run(script)
    assert held.ended is MotionEnd.HELD and held.reason == "somebody is in the way"
    assert arms.use("a")[1] <= EXACT
    before_s = len(arms.sent["a"])
    arms.run(lambda: trio.sleep(0.3))
    assert np.ptp(np.array(arms.sent["a"])[before_s:], axis=0).max() == 0.0, "it holds still"


def test_two_arms_start_together_and_each_says_how_it_ended():
    arms = PlainArms(("a", "b"))
    short = rest_to_rest(HOME, HOME + 0.2 * (GOAL - HOME), PAPER)

    executions = arms.run(lambda: arms.robot.move({"a": there(), "b": short}))
    assert executions["a"].times_s[0] == executions["b"].times_s[0]
    assert len(executions["b"].times_s) < len(executions["a"].times_s)
    assert {e.ended for e in executions.values()} == {MotionEnd.DONE}


def test_a_motion_of_a_moving_arm_is_refused_but_may_replace():
    arms = PlainArms()

    async def script():
        async with running(arms.robot.move, {"a": there()}) as ends:
            await trio.sleep(0.2)
            at = arms.robot.setpoint("a")
            with pytest.raises(TrocarError, match="already moving"):
                await arms.robot.move({"a": rest_to_rest(at.q, HOME, PAPER)})
            ends.append(await arms.robot.replace({"a": stop_from(at)}))
        return ends

    first, second = arms.run(script)
    assert first["a"].ended is MotionEnd.REPLACED
    assert second["a"].ended is MotionEnd.DONE
    velocity, acceleration = arms.use("a")
    assert velocity <= EXACT and acceleration <= EXACT, "no leap where one motion took over from the other"


def stop_from(at, seconds=0.35):
    """Return a motion that starts as the set-point is and comes to rest: uniform braking of every joint."""
    end = at.q + 0.5 * seconds * at.velocity
    return Trajectory.hermite([0.0, seconds], [at.q, end], [at.velocity, np.zeros(6)])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_set_points_can_be_streamed_by_replacing_again_and_again(seed):
    """Each new motion lasts a moment and starts where the last one has come to; nothing leaps."""
    rng = np.random.default_rng(seed)
    arms = PlainArms()

    async def script():
        async with trio.open_nursery() as nursery:
            nursery.start_soon(arms.robot.move, {"a": there()})
            for _ in range(25):
                await trio.sleep(0.02 * rng.integers(1, 3))
                at = arms.robot.setpoint("a")
                wanted = at.velocity + rng.uniform(-0.4, 0.4, 6) * PAPER.acceleration * 0.1
                nursery.start_soon(
                    arms.robot.replace, {"a": _ramp(at, np.clip(wanted, -0.3, 0.3) * [1, 1, 0.2, 1, 1, 1])}
                )

    arms.run(script)
    velocity, acceleration = arms.use("a")
    assert velocity <= EXACT and acceleration <= 1.0 + 1e-3


def _ramp(at, velocity, seconds=0.15):
    """From the set-point to another velocity, then to rest: cubic pieces within the limits."""
    middle = at.q + 0.5 * seconds * (at.velocity + velocity)
    end = middle + 0.5 * seconds * velocity
    return Trajectory.hermite([0.0, seconds, 2 * seconds], [at.q, middle, end], [at.velocity, velocity, np.zeros(6)])


def test_jaws_stop_where_they_are_when_their_script_is_cancelled():
    arms = PlainArms()

    async def script():
        with trio.move_on_after(0.05):
            await arms.robot.jaw("a", 1.2)
        await trio.sleep(0.2)
        return arms.robot.read("a").jaw_rad

    assert 0.1 < arms.run(script) < 0.6


def test_a_second_goal_of_the_jaws_ends_the_first():
    arms = PlainArms()

    async def script():
        async with running(arms.robot.jaw, "a", 1.2) as ends:
            await trio.sleep(0.05)
            ends.append(await arms.robot.jaw("a", 0.2))
        return ends

    assert [end.ended for end in arms.run(script)] == [MotionEnd.REPLACED, MotionEnd.DONE]
    assert arms.robot.read("a").jaw_rad == pytest.approx(0.2)


def test_an_arm_that_is_not_there_is_named():
    arms = PlainArms()
    with pytest.raises(TrocarError, match=r"arm 'z' is unknown; choose one of a"):
        arms.robot.setpoint("z")


@pytest.mark.parametrize("slower", [1.0, 2.0])
def test_it_knows_which_share_of_its_limits_was_sent(slower):
    arms, motion = PlainArms(), there().stretched(slower)
    arms.run(lambda: arms.robot.move({"a": motion}))
    velocity, acceleration = arms.driver.limit_use("a")
    t = np.linspace(0.0, motion.duration_s, 2001)
    assert velocity == pytest.approx((np.abs(motion(t, 1)) / PAPER.velocity).max(), rel=0.01)
    assert acceleration == pytest.approx(1.0 / slower**2, rel=0.03)
    assert acceleration == pytest.approx(arms.use("a")[1], rel=0.03)


@pytest.mark.parametrize(("goal_rad", "widest_rad"), [(0.4, 0.4), (-0.2, 0.04)])
def test_jaws_ramp_at_their_speed_and_have_arrived_when_they_hold_still(goal_rad, widest_rad):
    arms = PlainArms()

    async def script():
        assert arms.driver.idle("a")
        async with running(arms.robot.jaw, "a", goal_rad) as ends:
            await trio.sleep(0.001)
            assert arms.driver.widest_jaw_rad("a") == pytest.approx(widest_rad) and not arms.driver.idle("a")
        return ends[0], arms.now_s()

    execution, now_s = arms.run(script)
    sign = np.sign(goal_rad - 0.1)
    assert np.diff([0.1, *execution.measured[:, 6]])[:4] == pytest.approx([sign * 0.06] * 4)  # 6 rad/s, ticks of 10 ms
    assert now_s == pytest.approx(0.05 + 0.05, abs=0.011) and execution.done
    assert arms.robot.read("a").jaw_rad == pytest.approx(goal_rad) and arms.driver.idle("a")


def test_held_jaws_stop_and_say_why_and_jaws_at_rest_are_not_asked():
    arms = PlainArms(("a", "b"))

    async def script():
        async with running(arms.robot.jaw, "a", 1.2) as ends:
            await trio.sleep(0.05)
            arms.robot.hold(reason="a hand is between them")
            await arms.robot.rest()
        return ends[0]

    held = arms.run(script)
    assert (held.ended, held.reason) == (MotionEnd.HELD, "a hand is between them")
    assert 0.3 < arms.robot.read("a").jaw_rad < 0.5 and arms.robot.read("b").jaw_rad == 0.1
    assert arms.run(lambda: arms.robot.jaw("b", 0.2)).ended is MotionEnd.DONE


def test_whoever_waits_when_the_loop_is_gone_is_told_and_so_is_whoever_comes_later():
    arms = PlainArms()

    async def script():
        async with running(arms.robot.jaw, "a", 1.2) as ends, running(arms.robot.move, {"a": there()}) as moved:
            await trio.sleep(0.05)
            arms.driver.abandon("the connection is gone")
            await arms.robot.rest()
        assert not arms.robot.setpoint("a").moving
        return moved[0]["a"], *ends, await arms.robot.jaw("a", 0.3), (await arms.robot.move({"a": there()}))["a"]

    ends = arms.run(script)
    assert [(end.ended, end.reason) for end in ends] == [(MotionEnd.FAULT, "the connection is gone")] * 4
    for end in ends[2:]:
        assert len(end.times_s) == 0 and end.commanded.shape == end.measured.shape == (0, 7)


def test_what_is_still_played_is_told_with_its_start_and_that_it_brakes():
    arms, motion = PlainArms(), there()

    async def script():
        assert arms.driver.remaining("a") is None and not arms.driver.braking("a")
        async with running(arms.robot.move, {"a": motion}):
            await trio.sleep(0.2)
            assert arms.driver.remaining("a") == (motion, 0.0) and not arms.driver.braking("a")
            arms.driver.fault("a", reason="a test")
            at = arms.robot.setpoint("a")
            left, now_s = arms.driver.remaining("a")
            assert now_s == arms.now_s() and arms.driver.braking("a")
            assert np.abs(left(0.0) - at.q).max() < 1e-12
            assert left.times_s[1] == pytest.approx(TICK_S)

    arms.run(script)


def test_whoever_rests_waits_for_those_arms_only():
    arms = PlainArms(("a", "b"))

    async def script():
        async with running(arms.robot.move, {"a": there(), "b": there().stretched(3.0)}):
            await trio.sleep(0.05)
            await arms.robot.rest("a")
            assert not arms.robot.setpoint("a").moving and arms.robot.setpoint("b").moving
            await arms.robot.rest()
            assert not arms.robot.setpoint("b").moving

    arms.run(script)
