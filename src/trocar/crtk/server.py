"""A simulated cell as a robot that speaks CRTK: cables that err, grasps by friction, in real time."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence

import scipy.interpolate  # noqa: F401  # else the first motion would wait for it for a third of a second
import trio

from trocar.cell import Cell
from trocar.crtk.access import AccessBus, usual
from trocar.crtk.bus import Bus, open_bus
from trocar.crtk.faults import Fault, FaultyBus
from trocar.crtk.periods import Periods
from trocar.crtk.served_arm import ServedArm
from trocar.lab.topics import Topics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory

STEADY, AHEAD_S, SLOWEST = 0.02, 0.005, 0.1
"""The ticks' own time follows the machine's by this share of what it is off. Ahead by more than ``AHEAD_S`` it
waits, but goes on at least at ``SLOWEST``: stamps neither go back nor come from the future."""

MAX_LATE_S = 0.1
"""A robot's clock does not hurry after a stop; its ticks catch up with less."""


class CrtkServer:
    """Serves the arms of a simulated laboratory: ``laboratory.run(server.serve, budget_s, RealTime())``.

    Set-points of ``servo_jp`` are played back a little later as they were timed, exactly where they keep the arm's
    limits (``trocar.crtk.servo``). One that would need more than a joint's greatest speed is caught up with within the
    limits, and noted as the event ``servo``; a stream that breaks off ends within them.

    Args:
        laboratory: the cell.
        topics: namespace of each arm, and the network.
        speed: seconds of the cell a second.
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
            planted, allowed or usual(topics.interface), lambda topic: planted.arm_of(topic)[0], laboratory.log.event
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
        gc.freeze()  # what is there by now stays: to look through it again takes several ticks
        async with trio.open_nursery() as nursery:
            while True:
                self._now_s += TICK_S / self._speed
                off_s = time.time() - self._now_s
                caught_up = -AHEAD_S <= off_s <= MAX_LATE_S  # or will be: ticks hurry after a short stop
                slip_s = STEADY * off_s if caught_up else off_s
                self._now_s += max(slip_s, (SLOWEST - 1) * TICK_S / self._speed)
                with self._periods.tick():
                    for arm in self.arms.values():
                        arm.hear(nursery, self._now_s)
                        arm.tell(self._now_s)
                await cell.clock.sleep(TICK_S)
