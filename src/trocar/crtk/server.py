"""Serve a simulated cell as a robot that speaks CRTK, in real time, with cable errors and grasps by friction."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import scipy.interpolate  # noqa: F401  # else the first motion would wait for it for a third of a second
import trio

from trocar.cell import Cell
from trocar.crtk.access import AccessBus, default_allowed
from trocar.crtk.bus import Bus, open_bus, stamped
from trocar.crtk.faults import Fault, FaultyBus
from trocar.crtk.messages import IntervalStatistics
from trocar.crtk.served_arm import ServedArm
from trocar.lab.topics import Topics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory

STEADY, AHEAD_S, SLOWEST = 0.02, 0.005, 0.1
"""Each tick corrects the share ``STEADY`` of the difference between the ticks' time and the machine's. If it is more
than ``AHEAD_S`` ahead, the ticks' time slows down, but not below ``SLOWEST`` of its speed: stamps neither go back nor
come from the future."""

MAX_LATE_S = 0.1
"""After a longer stop, the ticks' time jumps to the machine's; after a shorter one, the ticks catch up."""

TOLD_S = 1.0
"""How often it is told how regularly the ticks come."""


class CrtkServer:
    """Serves the arms of a simulated laboratory: ``laboratory.run(server.serve, budget_s, RealTime())``.

    Streamed set-points are played back a little later with their sender's timing (``trocar.crtk.servo``), exactly if
    they keep the arm's limits. If one needs more than a joint's greatest speed, the arm catches up within the limits,
    and the event ``servo`` is noted. If a stream breaks off, the arm comes to rest within the limits.

    Args:
        laboratory: the cell.
        topics: namespace of each arm, and the network.
        speed: seconds of the cell per second.
        faults: to plant.
        allowed: who may command (``trocar.crtk.access``); default: everybody on the loopback interface, else nobody.
        bus: where to speak; default: the topics' own.

    Attributes:
        refused: commands that were refused, by client.
        movers: returns who has just moved an arm.
    """

    def __init__(
        self,
        laboratory: SimLaboratory,
        topics: Topics,
        speed: float = 1.0,
        *,
        faults: Sequence[Fault] = (),
        allowed: Sequence[str] = (),
        bus: Bus | None = None,
    ):
        self._now_s, self._speed = time.time(), speed
        session, planted = (
            laboratory.session,
            FaultyBus(bus or open_bus(topics), faults, laboratory.session.station, topics),
        )
        bus = AccessBus(
            planted,
            allowed or default_allowed(topics.interface),
            lambda topic: planted.arm_of(topic)[0],
            laboratory.log.event,
        )
        self.refused, self.movers = bus.refused, bus.movers
        self.arms = {
            name: ServedArm(name, model, laboratory, bus, topics.of_arm(name), session.T_world_base_registered[name])
            for name, model in laboratory.cell.arms.items()
        }
        self._periods = Periods(bus, [topics.of_arm(name) for name in self.arms])

    async def serve(self, cell: Cell) -> None:
        """Serve for ever."""
        gc.collect()
        gc.freeze()  # objects made so far stay; to scan them again takes several ticks
        async with trio.open_nursery() as nursery:
            while True:
                self._now_s += TICK_S / self._speed
                off_s = time.time() - self._now_s
                caught_up = -AHEAD_S <= off_s <= MAX_LATE_S  # or will be: ticks catch up after a short stop
                slip_s = STEADY * off_s if caught_up else off_s
                self._now_s += max(slip_s, (SLOWEST - 1) * TICK_S / self._speed)
                with self._periods.tick():
                    for arm in self.arms.values():
                        arm.hear(nursery, self._now_s)
                        arm.tell(self._now_s)
                await cell.clock.sleep(TICK_S)


class Periods:
    """Publishes statistics of each second's ticks on ``period_statistics`` of each arm, as a dVRK does.

    Args:
        bus: where to publish.
        topics: the arms' namespaces.
    """

    def __init__(self, bus: Bus, topics: Sequence[str]):
        self._out = [bus.publisher(f"{topic}/period_statistics", IntervalStatistics) for topic in topics]
        self._last_s: float | None = None
        self._usual_s = float("inf")
        self._ticks: list[tuple[float, float]] = []

    @contextmanager
    def tick(self) -> Iterator[None]:
        """Measure the period of a tick, and the time that the block takes."""
        began_s = time.perf_counter()
        yield
        if self._last_s is not None:
            self._ticks.append((began_s - self._last_s, time.perf_counter() - began_s))
        self._last_s = began_s
        if sum(period_s for period_s, _ in self._ticks) >= TOLD_S:
            self._tell(np.array(self._ticks))
            self._ticks.clear()

    def _tell(self, ticks: np.ndarray) -> None:
        """Publish the mean, deviation and range of periods and computing times, (n, 2), s."""
        figures = np.stack([ticks.mean(axis=0), ticks.std(axis=0), ticks.min(axis=0), ticks.max(axis=0)], axis=1)
        overruns = int((ticks[:, 1] > self._usual_s).sum())
        self._usual_s = figures[0, 0]
        told = IntervalStatistics(
            stamped(),
            *figures.ravel().tolist(),
            number_of_samples=len(ticks),
            number_of_overruns=overruns,
            statistics_interval=float(ticks[:, 0].sum()),
        )
        for out in self._out:
            if out.readers():
                out.send(told)
