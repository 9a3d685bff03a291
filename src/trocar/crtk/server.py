"""A simulated cell as a robot that speaks CRTK: cables that err, grasps by friction, in real time."""

from __future__ import annotations

import trio

from trocar.cell import Cell
from trocar.crtk.bus import open_bus
from trocar.crtk.served_arm import ServedArm
from trocar.lab.topics import Topics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory


class CrtkServer:
    """Serves the arms of a simulated laboratory: ``laboratory.run(server.serve, budget_s, RealTime())``.

    A set-point of ``servo_jp`` is reached at the end of the next tick, as on a real arm, whatever its acceleration; one
    that would need more than a joint's greatest speed is followed at that speed, and noted as the event ``servo``. Of
    several that come within a tick the last counts.

    Args:
        laboratory: the cell.
        topics: namespace of each arm, and the network.
    """

    def __init__(self, laboratory: SimLaboratory, topics: Topics):
        bus, session = open_bus(topics), laboratory.session
        self.arms = {
            name: ServedArm(name, model, laboratory, bus, topics.of_arm(name), session.T_world_base[name])
            for name, model in laboratory.cell.arms.items()
        }

    async def serve(self, cell: Cell) -> None:
        """Serve for ever."""
        async with trio.open_nursery() as nursery:
            while True:
                for arm in self.arms.values():
                    arm.hear(nursery)
                    arm.tell()
                await cell.clock.sleep(TICK_S)
