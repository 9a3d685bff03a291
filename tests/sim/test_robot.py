"""What a simulated arm's servos and encoders get in each tick, before a world that only takes notes."""

from types import SimpleNamespace

import numpy as np
import pytest
import trio
from numpy.testing import assert_allclose, assert_array_equal
from trio.testing import MockClock, wait_all_tasks_blocked

from driven import ARM, GOAL, HOME, PAPER
from trocar.cell import MotionEnd
from trocar.lab.transmission import JawCable
from trocar.motion import rest_to_rest
from trocar.robots import TICK_S
from trocar.sim.robot import SimRobot

OFF = np.array([0, 0, 0, 0.1, -0.2, 0.3])
SERVO_S = 2e-3


class Notes:
    """A world that notes what its drives are told, and how far it was stepped since."""

    def __init__(self):
        self.placed, self.driven, self.steps = {}, [], []

    def place_arm(self, name, q_joint, jaw_rad):
        self.placed[name] = q_joint, jaw_rad

    def drive_arm(self, name, target, velocity, jaw_rad):
        self.driven.append((len(self.steps), name, target, velocity, jaw_rad))

    def step(self, count):
        self.steps.append(count)

    def jaw_rad(self, name):
        return 0.7 if name == "a" else 0.2


class Bench:
    """Arms whose joints are off their commands by a constant."""

    def __init__(self, names=("a",), jaw=None):
        self.ticks, self.world, self.advanced = 0, Notes(), []
        self.robot = SimRobot(self.world, self.now_s)
        train = SimpleNamespace(joints=lambda q: q + OFF, advance=self.advanced.append)
        arm = SimpleNamespace(model=ARM, limits=PAPER, park_q=lambda: HOME, park_jaw_rad=0.1)
        for name in names:
            self.robot.attach_train(name, arm, train, jaw or JawCable())

    def now_s(self):
        return self.ticks * TICK_S

    def tick(self):
        """Let one tick pass; return what the drives were told in it."""
        self.world.driven.clear()
        self.world.steps.clear()
        self.robot.tick(self.now_s())
        self.ticks += 1
        assert self.world.steps == [2] * 5, "ten steps of the physics, the servos told anew before each second one"
        return self.world.driven

    def run(self, script):
        clock, rows = MockClock(), []

        async def turn():
            while True:
                await wait_all_tasks_blocked()
                rows.append(list(self.tick()))
                clock.jump(TICK_S)

        async def main():
            async with trio.open_nursery() as nursery:
                nursery.start_soon(turn)
                await script()
                nursery.cancel_scope.cancel()

        trio.run(main, clock=clock)
        return rows


def test_an_arm_is_put_where_its_cables_hold_its_joints():
    bench = Bench(jaw=JawCable(0.02, 0.0))
    q, jaw_rad = bench.world.placed["a"]
    assert_array_equal(q, HOME + OFF)
    assert jaw_rad == pytest.approx(0.12) and bench.robot.read("a").jaw_rad == 0.1
    bench.tick()
    assert bench.advanced == [TICK_S]
    reading = bench.robot.read("a")
    assert (reading.time_s, reading.jaw_rad) == (pytest.approx(0.01), pytest.approx(0.68)), (
        "its encoder knows no offset"
    )
    assert_array_equal(reading.q, HOME)


def test_an_idle_arm_is_told_once_a_tick_to_stay():
    bench = Bench(("a", "b"))
    for _ in range(2):
        told = bench.tick()
        assert [(step, name) for step, name, *_ in told] == [(0, "a"), (0, "b")]
        for _, _, target, velocity, jaw_rad in told:
            assert_array_equal(target, HOME + OFF)
            assert not velocity.any() and jaw_rad == pytest.approx(0.1)


def test_a_moving_arm_is_told_its_targets_and_their_speed_every_two_milliseconds():
    bench, motion = Bench(), rest_to_rest(HOME, GOAL, PAPER)

    async def script():
        await bench.robot.move({"a": motion})
        await trio.sleep(0.02)

    rows = bench.run(script)
    moving = [row for row in rows if len(row) == 5]
    assert [step for step, *_ in moving[0]] == [0, 1, 2, 3, 4]
    assert len(moving) == np.ceil(motion.duration_s / TICK_S) and all(len(row) in (1, 5) for row in rows)
    targets = np.array([target for row in moving for _, _, target, _, _ in row])
    velocities = np.array([velocity for row in moving for _, _, _, velocity, _ in row])
    times = SERVO_S * np.arange(1, len(targets) + 1)
    assert_allclose(targets, motion(np.minimum(times, motion.duration_s)) + OFF, atol=1e-12)
    assert_allclose(velocities, np.diff(targets, axis=0, prepend=(HOME + OFF)[None]) / SERVO_S, atol=1e-9)
    ((_, _, target, velocity, _),) = rows[-1]
    assert_allclose(target, GOAL + OFF)
    assert_allclose(velocity, 0.0, atol=1e-9)


def test_braked_in_the_middle_of_its_motion_it_is_told_what_it_is_commanded_until_it_rests():
    """Nobody is told what was to come before it was braked: drives, set-point and encoders agree in each tick."""
    bench, motion, ends = Bench(), rest_to_rest(HOME, GOAL, PAPER), []

    async def script():
        async with trio.open_nursery() as nursery:

            async def move():
                ends.append((await bench.robot.move({"a": motion}))["a"])

            nursery.start_soon(move)
            await trio.sleep(0.1)
            before = bench.robot.setpoint("a")
            bench.robot.hold("a", reason="a hand")
            assert_array_equal(bench.robot.setpoint("a").q, before.q)
            last_rate = 1.0
            while bench.robot.setpoint("a").moving:
                now = bench.now_s()
                await trio.sleep(TICK_S)
                at, (_, _, target, velocity, _) = bench.robot.setpoint("a"), bench.world.driven[-1]
                assert at.time_s == pytest.approx(now + TICK_S) and at.path_rate <= last_rate
                assert_allclose(target, at.q + OFF, atol=1e-12)
                assert_allclose(velocity, at.velocity, atol=0.06 * PAPER.velocity.max())
                assert_array_equal(bench.robot.read("a").q, at.q)
                last_rate = at.path_rate
            assert last_rate == 0.0
            await trio.sleep(0.05)

    rows = bench.run(script)
    (end,) = ends
    assert (end.ended, end.reason) == (MotionEnd.HELD, "a hand")
    at = bench.robot.setpoint("a")
    assert 0.01 < at.path_s < motion.duration_s / 2 and len(rows[-1]) == 1
    assert_array_equal(end.commanded[-1, :6], at.q)


def test_jaws_follow_through_the_play_of_their_cable():
    bench = Bench(jaw=JawCable(0.0, 0.03))

    async def script():
        await bench.robot.jaw("a", 0.2)
        await bench.robot.jaw("a", 0.15)

    rows = bench.run(script)
    pulled = [jaw_rad for row in rows for *_, jaw_rad in row]
    assert pulled[:3] == pytest.approx([0.1, 0.1, 0.106]), "12 mrad every 2 ms, the first 30 in its play"
    assert max(pulled) == pytest.approx(0.17) and pulled[-1] == pytest.approx(0.17), "and it stays, closing by less"
    assert bench.robot.read("a").jaw_rad == pytest.approx(0.67), "fingers at .7 keep the motor from closing further"


def test_a_silent_arm_goes_on_and_is_read_no_more_until_it_speaks_again():
    bench = Bench(("a", "b"))
    bench.tick()
    bench.robot.silence("a")
    bench.tick()
    assert bench.robot.read("a").time_s == pytest.approx(0.01) and bench.robot.read("b").time_s == pytest.approx(0.02)
    bench.robot.silence("a", silent=False)
    bench.tick()
    assert bench.robot.read("a").time_s == pytest.approx(0.03) and bench.robot.read("b").jaw_rad == pytest.approx(0.2)
