"""A simulated cell as a robot that speaks CRTK: cables that err, grasps by friction, in real time."""

from __future__ import annotations

import time

import scipy.interpolate  # noqa: F401  # else the first motion would wait for it for a third of a second
import trio

from trocar.cell import Cell
from trocar.crtk.bus import open_bus
from trocar.crtk.served_arm import ServedArm
from trocar.lab.topics import Topics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory

SLIP_S, STEADY = 0.05, 0.02
"""The ticks' own time follows the machine's this slowly, unless it is off by more than this."""

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
    """

    def __init__(self, laboratory: SimLaboratory, topics: Topics, speed: float = 1.0):
        self._now_s, self._speed = time.time(), speed
        bus, session = open_bus(topics), laboratory.session
        self.arms = {
            name: ServedArm(name, model, laboratory, bus, topics.of_arm(name), session.T_world_base_registered[name])
            for name, model in laboratory.cell.arms.items()
        }

    async def serve(self, cell: Cell) -> None:
        """Serve for ever."""
        async with trio.open_nursery() as nursery:
            while True:
                self._now_s += TICK_S / self._speed
                off_s = time.time() - self._now_s
                self._now_s += off_s if abs(off_s) > SLIP_S else STEADY * off_s
                for arm in self.arms.values():
                    arm.hear(nursery, self._now_s)
                    arm.tell()
                await cell.clock.sleep(TICK_S)
