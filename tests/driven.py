"""Arms without physics, whose encoders read the set-points: the loop that a driver needs around it."""

from __future__ import annotations

from contextlib import asynccontextmanager

import numpy as np
import trio
from trio.testing import MockClock, wait_all_tasks_blocked

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.cell import JointReading
from trocar.robots import TICK_S, Driver

ARM = ARMS["psm-classic"]
PAPER = MOTION_LIMITS["paper"]
HOME = np.array([0.85, 0.0, 0.18, -0.3, -0.1, -0.2])
GOAL = HOME + np.array([0.2, 0.15, -0.03, 0.9, 0.5, -0.6])
"""A motion from ``HOME`` to here takes about half a second."""
SERVO_S = 0.002


@asynccontextmanager
async def running(function, *args):
    """Run an async function beside the block; yield a list that receives its result."""
    results = []

    async def run():
        results.append(await function(*args))

    async with trio.open_nursery() as nursery:
        nursery.start_soon(run)
        yield results


class PlainArms:
    """Arms whose encoders read their set-points; their loop runs while a script runs.

    Attributes:
        driver: the driver of the arms.
        robot: the driver, or the wrapper that a test puts there for scripts.
        sent: for each arm, its set-points (6,), one every 2 ms.
        silent: names of arms that give no readings.
        each_tick: functions called after each tick.
    """

    def __init__(self, names=("a",), homes=None, limits=PAPER):
        self.ticks = 0
        self.driver = Driver(self.now_s)
        self.robot = self.driver
        homes = homes or {}
        for name in names:
            self.driver.attach(name, ARM, limits, homes.get(name, HOME), 0.1)
        self.sent = {name: [homes.get(name, HOME)] for name in names}
        self.silent: set[str] = set()
        self.each_tick = []

    def now_s(self):
        return self.ticks * TICK_S

    def run(self, script, *args):
        clock = MockClock()

        async def main():
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._turn, clock)
                try:
                    return await script(*args)
                finally:
                    with trio.CancelScope(shield=True):
                        self.robot.hold()
                        await self.robot.rest()
                    nursery.cancel_scope.cancel()

        return trio.run(main, clock=clock)

    async def _turn(self, clock):
        while True:
            await wait_all_tasks_blocked()
            times = self.now_s() + SERVO_S * np.arange(1, 6)
            rows = {name: self.driver.targets(name, times) for name in self.driver.names}
            for name, (q, _, _) in rows.items():
                self.sent[name] += list(q)
            self.ticks += 1
            now = self.now_s()
            self.driver.note(
                now,
                {
                    name: JointReading(now, q[-1], float(jaw[-1]))
                    for name, (q, _, jaw) in rows.items()
                    if name not in self.silent
                },
            )
            for call in self.each_tick:
                call()
            clock.jump(TICK_S)

    def use(self, name, limits=PAPER):
        """Return the largest velocity and acceleration of an arm's set-points, as shares of the limits."""
        q = np.array(self.sent[name])
        v = np.diff(q, axis=0) / SERVO_S
        a = np.diff(v, axis=0, prepend=np.zeros((1, 6))) / SERVO_S
        return np.abs(v / limits.velocity).max(), np.abs(a / limits.acceleration).max()
