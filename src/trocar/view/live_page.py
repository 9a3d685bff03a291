"""The process of a live page: whoever runs the cell hands it moments, and never waits for it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from trocar.errors import MachineError
from trocar.view.live import LiveView, Moment, Scene

NICE = 19
"""Added to the process's niceness: where cores are few, the arms come first."""
PAUSE_S = 0.02
"""It looks so often for the next moment. If it waited for it instead, it would be woken, and take the core, in the
middle of the tick of whoever sends it: that cost 10 ms on a busy machine."""
START_S = 120.0
"""The page is there within this time."""
END_S = 5.0
"""It ends within this time."""
IDLE_S = 0.5
"""While no browser has it open, it asks for moments so slowly."""
LOOK_S = 0.1
"""So often it looks for images."""

Images = Callable[[], Iterable[tuple[str, NDArray[np.uint8], str]]]
"""Returns what has come since the last call: camera, image (h, w, 3), what is said about it."""


class LivePage:
    """A page in a process of its own: a context manager, with which it ends.

    Args:
        scene: of the cell; goes to the process.
        title: of the page.
        moment: the first one.
        port: as ``LiveView`` takes it.
        listen: begins to listen for images, in the process, once a browser has opened the page; None: there are none.

    Attributes:
        port: that it got.
    """

    def __init__(
        self,
        scene: Scene,
        title: str,
        moment: Moment,
        port: int = 8080,
        listen: Callable[[], Images] | None = None,
    ):
        spawn = get_context("spawn")
        self._pipe, self._theirs = spawn.Pipe()
        given = (scene, title, moment, port, listen, self._theirs)
        self._process = spawn.Process(target=show_for_ever, args=given, daemon=True)
        self._waits, self.port = False, 0

    def __enter__(self) -> LivePage:
        self._process.start()
        self._theirs.close()  # else neither end would notice that the other has gone
        try:
            if self._pipe.poll(START_S):
                self.port, self._waits = self._pipe.recv(), True
        except EOFError:
            pass
        if not self._waits:
            raise MachineError("the process that shows the page has ended, or did not start")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._pipe.close()
        self._process.join(END_S)
        self._process.kill()

    @property
    def waits(self) -> bool:
        """Return whether it has shown the last moment; never again once its process has ended."""
        try:
            while self._pipe.poll():
                self._waits = self._pipe.recv()
        except (EOFError, OSError):
            self._waits = False
        return self._waits

    def show(self, moment: Moment) -> None:
        """Show a moment; only when it waits for one, so that no more than one is ever under way."""
        self._waits = False
        with suppress(OSError):  # it has ended
            self._pipe.send(moment)


def show_for_ever(
    scene: Scene, title: str, moment: Moment, port: int, listen: Callable[[], Images] | None, pipe: Connection
) -> None:
    """Show moments until the other end has gone; each is answered with True, the start with the port."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with its parent
    view = LiveView(scene, title, moment, port)
    os.nice(NICE)
    images: Images | None = None
    look_s = 0.0
    try:
        pipe.send(view.port)
        while True:
            while not pipe.poll():
                time.sleep(PAUSE_S)
            view.show(pipe.recv())
            if not view.watched:
                pipe.poll(IDLE_S)  # nothing comes before the answer, unless the other end goes
            pipe.send(True)
            if time.monotonic() < look_s:
                continue
            look_s = time.monotonic() + LOOK_S
            if images is None and listen is not None and view.watched:
                images = listen()
            for camera, color, said in images() if images is not None else ():
                view.show_image(camera, color, said)
    except (EOFError, OSError):
        view.close()
