"""Motions that are pushed off their paths, while set-points stay those that were asked for."""

import numpy as np
import pytest
import trio

from driven import ARM, HOME, PAPER, PlainArms, running
from trocar.arms import MotionLimits, fk
from trocar.errors import MotionRefused
from trocar.geometry import SE3
from trocar.motion import rest_to_rest
from trocar.motion.moves import move_to
from trocar.robots import ArmGuard, Guarded
from trocar.robots.shaken import Shaken

GOAL = HOME + np.array([0.2, 0.15, -0.03, 0.5, 0.3, -0.4])
GENTLE = MotionLimits(PAPER.velocity, 0.5 * PAPER.acceleration)
SLOW = rest_to_rest(HOME, GOAL, PAPER).stretched(2.0)


def shaken(push_m=2e-3, seed=1, workspace_m=None):
    arms = PlainArms()
    guard = Guarded(arms.driver, {"a": ArmGuard(ARM, PAPER, SE3.identity(), workspace_m)})
    arms.robot = Shaken(guard, {"a": ARM}, np.random.default_rng(seed), push_m)
    arms.each_tick.append(guard.check)
    return arms


def watched(arms, script):
    """Run a script; return set-points (n, 6) as they were asked for and as they were sent, every 10 ms."""
    asked, sent = [], []
    arms.each_tick.append(lambda: asked.append(arms.robot.setpoint("a").q))
    arms.each_tick.append(lambda: sent.append(arms.driver.setpoint("a").q))
    arms.run(script)
    return np.array(asked), np.array(sent)


def apart_m(asked, sent):
    return fk(ARM, sent).translation_m - fk(ARM, asked).translation_m


def test_the_arm_leaves_the_path_and_comes_back_while_set_points_stay_on_it():
    arms, pushes = shaken(), []
    arms.each_tick.append(lambda: pushes.append(arms.robot.push("a")))
    asked, sent = watched(arms, lambda: arms.robot.move({"a": SLOW}))
    off = np.linalg.norm(apart_m(asked, sent), axis=1)
    moving_s = 0.01 * np.arange(1, len(asked) + 1)
    np.testing.assert_allclose(pushes, sent - asked, atol=1e-12)
    assert 5e-4 < off.max() < 12e-3 and abs(moving_s[off.argmax()] - SLOW.duration_s / 2) < 0.1
    np.testing.assert_allclose(asked, SLOW(moving_s), atol=1e-9)
    np.testing.assert_allclose(sent[-1], GOAL, atol=1e-9)
    velocity, acceleration = arms.use("a")
    assert velocity < 1.0 and acceleration < 1.0


def test_pushes_are_as_large_as_asked_for_and_the_same_for_the_same_seed():
    pushes = []
    for seed in (*range(60), 0):
        arms = shaken(seed=seed)
        pushed = arms.robot._with_push("a", SLOW)
        middle = SLOW.duration_s / 2
        pushes.append(apart_m(SLOW(middle), pushed(middle)))
    np.testing.assert_array_equal(pushes[0], pushes[-1])
    np.testing.assert_allclose(np.std(pushes[:-1]), 2e-3, rtol=0.2)


def test_a_motion_that_was_prepared_is_pushed_once():
    arms = shaken()
    arms.robot.prepare({"a": SLOW})
    ready = arms.robot._pushed["a"][1]
    _, sent = watched(arms, lambda: arms.robot.move({"a": SLOW}))
    np.testing.assert_allclose(sent, ready(0.01 * np.arange(1, len(sent) + 1)), atol=1e-9)


def test_a_motion_that_takes_over_begins_where_the_push_has_brought_the_arm():
    arms = shaken(push_m=1e-3)

    async def script():
        async with running(arms.robot.move, {"a": SLOW}) as first:
            await trio.sleep(SLOW.duration_s / 2)
            now = arms.robot.setpoint("a")
            assert np.abs(now.q - arms.driver.setpoint("a").q).max() > 1e-4, "else there is nothing to take over"
            back = move_to(now.q, now.velocity, HOME, GENTLE)
            result = await arms.robot.replace({"a": back})
            assert result["a"].done
        assert not first[0]["a"].done

    watched(arms, script)
    np.testing.assert_allclose(arms.driver.setpoint("a").q, HOME, atol=1e-9)


def test_a_push_out_of_the_workspace_is_left_out_and_a_refused_motion_stays_refused():
    tips = fk(ARM, SLOW(np.linspace(0, SLOW.duration_s, 200))).translation_m
    box = np.stack([tips.min(axis=0) - 1e-4, tips.max(axis=0) + 1e-4])
    arms = shaken(push_m=10e-3, workspace_m=box)
    asked, sent = watched(arms, lambda: arms.robot.move({"a": SLOW}))
    np.testing.assert_allclose(asked, sent, atol=1e-9)
    beyond = rest_to_rest(GOAL, HOME - np.array([0.3, 0.2, 0, 0, 0, 0]), PAPER)

    async def refused():
        with pytest.raises(MotionRefused):
            await arms.robot.move({"a": beyond})
        np.testing.assert_allclose(arms.robot.setpoint("a").q, GOAL, atol=1e-9)

    arms.run(refused)


def test_an_arm_that_was_stopped_is_where_it_is():
    arms = shaken()

    async def script():
        async with running(arms.robot.move, {"a": SLOW}):
            await trio.sleep(SLOW.duration_s / 2)
            arms.robot.hold()
            await arms.robot.rest("a")
        np.testing.assert_array_equal(arms.robot.setpoint("a").q, arms.driver.setpoint("a").q)

    arms.run(script)
