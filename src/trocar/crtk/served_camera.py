"""The cameras of a served cell: a message on ``CAMERA/trigger`` makes one expose and publish an image."""

from __future__ import annotations

import time
from contextlib import suppress
from multiprocessing import get_context

import trio

from trocar.cell import Cell
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.messages import Empty, Header
from trocar.crtk.renderer import Exposure, Studio, render_for_ever
from trocar.errors import InvalidValue, MachineError
from trocar.eval.staged import Files
from trocar.lab.topics import Topics
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.world import state_of

AHEAD = 2
"""Number of images that may wait at the renderer."""
CLOCK_S = 0.03
"""Requests in this last part of an exposure start another one, so a client's clock may be ahead by this much."""
START_S = 120.0
"""Time in which the renderer must get ready."""
END_S = 5.0
"""Time in which the renderer must end."""


class ServedCameras:
    """Publishes images of a simulated laboratory: a context manager, whose renderer ends with it.

    A camera runs freely until something comes on its topic ``trigger``; from then on it exposes an image for each
    trigger and no other. Triggered images draw the noise of the laboratory's own cameras, so they are the images that
    a script in the laboratory would see.

    Args:
        laboratory: the cell.
        topics: namespace of each camera, and the network.
        hz: images a second of a camera that runs freely; 0: none.
    """

    def __init__(self, laboratory: SimLaboratory, topics: Topics, hz: float):
        if not 0 <= hz < 1 / TICK_S:
            raise InvalidValue("--images-hz", hz, f"give 0 to {1 / TICK_S:g}")
        self._world, self._cameras, self._hz = laboratory.world, laboratory.cameras, hz
        bus = open_bus(topics)
        self._triggers = {
            name: bus.subscriber(f"{topics.of_camera(name)}/trigger", Empty) for name in laboratory.cameras
        }
        spawn = get_context("spawn")
        self._pipe, self._theirs = spawn.Pipe()
        self._waiting = 1
        self._process = None
        if laboratory.cameras:
            renderers = {name: camera.renderer for name, camera in laboratory.cameras.items()}
            noise = next(iter(laboratory.cameras.values())).rng
            studio = Studio(renderers, noise, topics)
            self._process = spawn.Process(target=render_for_ever, args=(studio, self._theirs), daemon=True)

    def __enter__(self) -> ServedCameras:
        if self._process is not None:
            self._process.start()
            self._theirs.close()  # else neither end would notice that the other has gone
            deadline_s = time.monotonic() + START_S
            while self._pending():
                if time.monotonic() > deadline_s:
                    self._process.kill()
                    self._process.join(END_S)
                    raise MachineError(f"the process that renders images is not ready after {START_S:g} s")
                self._pipe.poll(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._pipe.close()
        if self._process is not None:
            self._process.join(END_S)
            self._process.kill()

    def files(self) -> Files:
        """Return the triggered images; none if the renderer has ended, as serving has then told."""
        if self._process is not None:
            with suppress(MachineError, OSError, EOFError):
                while self._pending():
                    self._pipe.poll(0.05)
                self._pipe.send(None)
                return self._pipe.recv()
        return {}, {}

    async def serve(self, cell: Cell) -> None:
        """Serve for ever."""
        async with trio.open_nursery() as nursery:
            for name in self._cameras:
                nursery.start_soon(self._serve, name, cell)

    async def _serve(self, name: str, cell: Cell) -> None:
        trigger, due_s, free = self._triggers[name], cell.clock.now_s(), self._hz > 0
        while True:
            if trigger.take():
                free = False
                await cell.clock.sleep(max(0.0, self._cameras[name].exposure_s - CLOCK_S))
                trigger.take()  # requests so far are answered by this image, too: its stamp is later
                await cell.clock.sleep(min(CLOCK_S, self._cameras[name].exposure_s))
                header, state = stamped(), state_of(self._world)
                while self._pending() >= AHEAD:
                    await cell.clock.sleep(TICK_S)
                self._expose(name, header, state, kept=True)
            elif free and cell.clock.now_s() >= due_s and not self._pending():
                due_s = cell.clock.now_s() + 1 / self._hz
                self._expose(name, stamped(), state_of(self._world), kept=False)
            await cell.clock.sleep(TICK_S)

    def _expose(self, name: str, header: Header, state: bytes, *, kept: bool) -> None:
        self._waiting += 1
        try:
            self._pipe.send(Exposure(name, header, state, kept))
        except OSError:
            raise self._ended() from None

    def _pending(self) -> int:
        """Return how many images are still to be published.

        Raises:
            MachineError: the renderer has ended.
        """
        try:
            while self._pipe.poll():
                self._pipe.recv()
                self._waiting -= 1
        except (EOFError, OSError):
            raise self._ended() from None
        return self._waiting

    def _ended(self) -> MachineError:
        assert self._process is not None
        self._process.join(END_S)
        return MachineError(f"the process that renders images has ended (exit code {self._process.exitcode})")
