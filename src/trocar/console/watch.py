"""The live page of a run: it stays open from trial to trial, so that a person can attend each of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np

from trocar.arms import fk
from trocar.cell import SEAT, Cell
from trocar.console.console import Console
from trocar.console.inputs import Inputs
from trocar.console.lobby import Lobby
from trocar.errors import EmergencyStop, MachineError
from trocar.eval.config import RunConfig
from trocar.eval.sight import sight_of
from trocar.hardware.laboratory import HardwareLaboratory
from trocar.log import Sighting
from trocar.perception.depth import project
from trocar.perception.image import RgbdImage
from trocar.replay import painted
from trocar.sim.laboratory import SimLaboratory
from trocar.view.console_view import ConsoleMoment, ConsoleView
from trocar.view.live import Picture
from trocar.view.live_page import LivePage
from trocar.view.wishes import Level, Said, Wish

EVERY_S = 0.03
"""Wall-clock time between two moments: three ticks in real time."""
STILL_S = 0.25
"""The same, in addition, while the cell's clock is paused and the person says nothing: then nothing changes."""
STATE_S = 0.02
"""Wall-clock time between two states for devices."""
SET_UP_S = 1.0
"""Time for the page to show that the next trial is set up, which takes a while."""
FROZEN_S = 5.0
"""A page whose process has not shown a moment for this long counts as left: nobody could stop an arm there."""
OF_ANY_TRIAL = (Wish.STOP, Wish.GO_ON, Wish.EMERGENCY, Wish.LEFT, Wish.LEVEL, Wish.SPEED, Wish.PAUSE)
"""Wishes that count even between two trials; all others were meant for the trial that has ended."""
IMAGE_PX = 480
"""Maximum width of an image on the page."""


class Watch:
    """A live page with a console for each trial of a run; a context manager that closes the page.

    Args:
        level: what a script needs confirmation for.
        speed: seconds of the cell's clock per second; 0: no limit.
        port: as in ``LiveView``; None: no page.
        inputs: port for devices that move arms (``Inputs``); None: no devices.
        told: called with the page's address, and with that for devices, once they are open.

    Attributes:
        console: of the present or last trial, or of the time between two.
        latencies_s: times from input to set-point, of all trials.
    """

    def __init__(
        self,
        level: Level = Level.AUTONOMOUS,
        speed: float = 1.0,
        port: int | None = 8080,
        inputs: int | None = None,
        told: Callable[[str], None] = lambda address: None,
    ):
        self._port, self._told_address = port, told
        self._page: LivePage | None = None
        self._open = ExitStack()
        self._left_over: list[Said] = []
        self._inputs = None if inputs is None else Inputs(inputs, lambda: self._state)
        self.latencies_s: list[float] = []
        self.console: Console | Lobby = Console(level, speed)
        self._state = state_of(self.console)
        self._due_s, self._state_due_s, self._trials = 0.0, 0.0, 0
        self._simulated = True
        self._frozen = False  # whether the page's process does not answer
        self._shown: tuple[float, bool, bool] | None = None  # the clock and what is asked, as the page shows them

    def __enter__(self) -> Watch:
        if self._inputs is not None:
            self._open.enter_context(self._inputs)
            self._told_address(f"tcp://127.0.0.1:{self._inputs.port} for devices")
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    @property
    def address(self) -> str:
        """Return the address of the page; empty before the first trial."""
        return "" if self._page is None else f"http://127.0.0.1:{self._page.port}"

    @property
    def ended(self) -> str:
        """Return why the person ended the last trial, and the run with it; empty if nobody did."""
        return self.console.ended

    def attend(self, config: RunConfig, laboratory: SimLaboratory | HardwareLaboratory) -> None:
        """Join the laboratory of a trial; open the page if this is the first trial.

        Arms that were stopped in the previous trial stay stopped, and a clock that was paused stays paused.

        Raises:
            EmergencyStop: the person ended the previous trial.
        """
        if self.ended:
            raise EmergencyStop(f"{self.ended}: the run ends here; the same command continues")
        self._keep_wishes()
        self._sight, self._trials = sight_of(laboratory), self._trials + 1
        self._flaws = {} if config.robot else config.about()["flaws"]
        difficulty = () if config.robot else (f"flaws: {', '.join(config.how_difficult)}",)
        self._clock = ", ".join([f"trial {self._trials}", config.method, *difficulty])
        from trocar.report.files import task_report  # Matplotlib only when needed

        solids = painted(self._sight.scenery.solids, task_report(config.task).colours)
        scenery = replace(self._sight.scenery, solids=solids)
        simulated = laboratory if isinstance(laboratory, SimLaboratory) else None
        self._simulated = simulated is not None
        console = Console(
            self.console.level,
            self.console.speed,
            noun=config.task.goal_noun,
            hear=self._hear,
            show=self._show,
            paced=self._simulated,
            over=lambda: simulated is not None and simulated.interrupted,
            stopped=self.console.stopped,
            paused=self.console.paused,
        )
        console.latencies_s = self.latencies_s
        self.console, self._scene = console, None if self._page is None else scenery
        laboratory.wrap_robot(console.supervise)
        seated = {**laboratory.cell.assistants, SEAT: console}
        laboratory.cell = replace(laboratory.cell, assistants=seated)
        if self._page is None and self._port is not None:
            title = f"{config.task.name} {config.task.variant}".strip()
            page = LivePage(scenery, title, self._moment(), self._port, opens=ConsoleView)
            self._page = self._open.enter_context(page)
            self._told_address(self.address)

    def next_method(self, words: str, methods: Sequence[str]) -> str:
        """Wait until the person begins another trial; return its method.

        Args:
            words: what the last trial gave.
            methods: among which the person may choose, the last one's first.

        Raises:
            MachineError: the page's process has ended.
        """
        self._keep_wishes()
        last, paced = self.console, self._simulated
        lobby = Lobby(words, methods, last.level, last.speed, paced=paced, stopped=last.stopped, paused=last.paused)
        self.console = lobby
        while not lobby.chosen:
            for said in self._hear():
                lobby.take_in(said)
            if self._page is not None and self._page.ended:
                raise MachineError("the process that shows the page has ended; the same command continues")
            self._show()
            time.sleep(STATE_S)
        end_s = time.monotonic() + SET_UP_S
        while self._page is not None and not self._page.waits and time.monotonic() < end_s:
            time.sleep(STATE_S)
        self._due_s, self._shown = 0.0, None
        self._show()
        return lobby.chosen

    @property
    def _trial(self) -> Console:
        assert isinstance(self.console, Console)  # while a trial runs
        return self.console

    async def wait(self, now_s: float) -> None:
        """Return when the next tick may begin."""
        await self._trial.wait(now_s)

    async def serve(self, cell: Cell) -> None:
        """Carry out what the person asks for."""
        await self._trial.serve(cell)

    def heard(self, event: Mapping[str, object]) -> None:
        """Note an event of the log."""
        if isinstance(self.console, Console):  # an arm may report a fault while the next trial is set up
            self.console.note(event)

    @property
    def asks(self) -> bool:
        """Return whether a motion waits for confirmation."""
        return self.console.asks

    def _keep_wishes(self) -> None:
        """Keep of the wishes so far those that hold beyond the trial, or the set-up, in which they were made."""
        self._left_over = [one for one in self._hear() if one.wish in OF_ANY_TRIAL]

    def _hear(self) -> list[Said]:
        heard, self._left_over = [*self._left_over, *(self._page.said() if self._page else [])], []
        if self._page is not None:
            heard += self._missing(self._page)
        heard += self._inputs.said() if self._inputs else []
        self._shown = None if heard else self._shown
        return heard

    def _missing(self, page: LivePage) -> list[Said]:
        """Return what it means that the page's process has ended, or does not answer: nobody can press anything."""
        frozen = page.unanswered_s > FROZEN_S and self.console.needed
        fell_silent, self._frozen = frozen and not self._frozen, frozen
        if page.ended and (self.console.needed or self.console.stopped or self.console.paused) and not self.ended:
            return [Said(Wish.EMERGENCY, value="the process that shows the page has ended")]
        return [Said(Wish.LEFT)] if fell_silent else []

    def _show(self) -> None:
        now = time.monotonic()
        if self._inputs is not None and now >= self._state_due_s:
            self._state_due_s = now + STATE_S
            self._state = state_of(self.console)
        if self._page is None or now < self._due_s:
            return
        shown = (self.console.now_s, self.console.asks, bool(self.ended))
        if shown == self._shown and now < self._due_s + STILL_S:
            return
        if self._page.waits:
            self._due_s, self._shown = max(self._due_s + EVERY_S, now), shown
            self._page.show(self._moment())

    def _moment(self) -> ConsoleMoment:
        seen, scene, self._scene = self._sight.look(), self._scene, None
        return ConsoleMoment(
            seen.time_s,
            seen.arrays,
            clock=self._clock,
            events=seen.events,
            contacts=seen.contacts,
            spans=seen.spans,
            begun=seen.begun,
            flaws=self._flaws,
            standing=self.console.standing,
            images=tuple(picture(name, found) for name, found in self._sight.images().items()),
            scene=scene,
        )


def state_of(console: Console | Lobby) -> Mapping[str, Any]:
    """Return time, arms and the console's state in words, for a device, as JSON values."""
    arms = dict[str, Any]()
    if isinstance(console, Lobby) or console.cell is None:
        return {"time_s": 0.0, "arms": arms, "words": "no trial runs"}
    cell = console.cell
    for arm in cell.arms:
        reading, q = cell.robot.read(arm), cell.robot.setpoint(arm).q
        tip = cell.T_world_base_registered[arm] @ fk(cell.arms[arm], q)
        arms[arm] = {
            "position": tip.translation_m.tolist(),
            "quaternion": tip.rotation.as_quaternion()[[1, 2, 3, 0]].tolist(),
            "jaw": reading.jaw_rad,
            "held": arm in console.hands and console.hands[arm].held,
        }
    return {"time_s": cell.clock.now_s(), "arms": arms, "words": console.standing.words}


def picture(camera: str, found: Sighting) -> Picture:
    """Return an image (of a stereo pair, the left one) for the page, with what perception found in it."""
    image = found.image
    color, lens = (image.color, image.intrinsics) if isinstance(image, RgbdImage) else (image.left, image.rig.left)
    thin = -(-color.shape[1] // IMAGE_PX)
    outlines_px = {name: project(lens, m) / thin for name, m in found.outlines_m.items()}
    said = f"taken at {image.time_s:.2f} s" + (f"; found: {', '.join(outlines_px)}" if outlines_px else "")
    return Picture(camera, np.ascontiguousarray(color[::thin, ::thin]), said, outlines_px)
