"""A simulated cell on the topics of its station: arms, cameras, and whatever else accompanies them, on one clock."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import trio

from trocar.cell import Cell
from trocar.crtk.faults import Fault
from trocar.crtk.served_camera import ServedCameras
from trocar.crtk.server import MAX_LATE_S, CrtkServer
from trocar.errors import TrocarError
from trocar.eval.staged import FAULT, End, Files
from trocar.hardware.priority import ahead_of_others
from trocar.lab.topics import Topics
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.pace import RealTime, Script
from trocar.sim.world import PhysicsError

ENDING = (signal.SIGTERM, signal.SIGHUP)
"""Signals that end serving as Ctrl-C does."""


@dataclass(frozen=True)
class Timeliness:
    """How well a served cell kept its time.

    Attributes:
        late_share: share of its ticks that began a whole tick late, or more.
        latest_s: the greatest lateness.
        core_share: share of one core that its process used, without the cameras' process.
    """

    late_share: float
    latest_s: float
    core_share: float


class ServedCell:
    """Serves a laboratory; a context manager.

    Args:
        laboratory: the cell.
        topics: names and network.
        speed: seconds of the cell per second.
        images_hz: images per second of cameras that run freely.
        faults: to plant.
        allowed: clients that may command, as ``CrtkServer`` takes them.

    Attributes:
        arms: by name.
        refused: commands that were refused, by client.
        movers: returns who has just moved an arm.
    """

    def __init__(
        self,
        laboratory: SimLaboratory,
        topics: Topics,
        speed: float = 1.0,
        images_hz: float = 1.0,
        *,
        faults: Sequence[Fault] = (),
        allowed: Sequence[str] = (),
    ):
        self._laboratory, self._pace = laboratory, RealTime(speed, MAX_LATE_S)
        self._server = CrtkServer(laboratory, topics, speed, faults=faults, allowed=allowed)
        self._cameras = ServedCameras(laboratory, topics, images_hz)
        self.arms, self.refused, self.movers = self._server.arms, self._server.refused, self._server.movers
        self._core_share = 0.0

    def __enter__(self) -> ServedCell:
        self._cameras.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._cameras.__exit__()

    def run(self, seconds: float, also: Sequence[Script] = ()) -> End:
        """Serve for a time, or until Ctrl-C or one of the signals ``ENDING``; return how it ended.

        Args:
            seconds: of the cell's clock.
            also: scripts that run beside it.
        """

        async def serve(cell: Cell) -> None:
            async with trio.open_nursery() as nursery:
                for script in (self._server.serve, self._cameras.serve, *also):
                    nursery.start_soon(script, cell)

        began_s, worked_s = time.perf_counter(), time.process_time()
        try:
            with _ended_by_signals(), ahead_of_others():
                self._laboratory.run(serve, seconds, self._pace)
        except KeyboardInterrupt:
            pass
        except PhysicsError:
            raise
        except TrocarError as error:
            return End(FAULT, str(error))
        finally:
            self._core_share = (time.process_time() - worked_s) / (time.perf_counter() - began_s)
        return End()

    def files(self) -> Files:
        """Return the images that were triggered."""
        return self._cameras.files()

    def timeliness(self) -> Timeliness:
        """Return how well the cell kept its time."""
        return Timeliness(self._pace.late_ticks / max(1, self._pace.ticks), self._pace.latest_s, self._core_share)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    before = {signal.SIGINT: signal.signal(signal.SIGINT, signal.default_int_handler)}  # a shell's `&` ignores it
    before |= {number: signal.signal(number, lambda *_: signal.raise_signal(signal.SIGINT)) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
