"""A live page in its own process: the program that runs the cell sends it moments, and never waits for it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

from trocar.errors import MachineError
from trocar.view.live import LiveView, Moment, Picture, Scene

NICE, NICE_HEARD = 19, 5
"""Added to the process's niceness, so that the arms come first where cores are few; a page with controls gets the
second. With the first, beside a browser without a graphics card, it had too little time to pass on a stop."""
PAUSE_S = 0.02
"""Interval at which the process polls for the next moment. If it blocked instead, it would wake up, and take the core,
in the middle of the sender's tick: that cost 10 ms on a busy machine."""
START_S = 120.0
"""Time limit for the page to start."""
END_S = 5.0
"""Time limit for the page to end."""
IDLE_S = 0.5
"""Interval between moments while no browser has the page open."""
LOOK_S = 0.1
"""Interval at which the process looks for images."""

Say = Callable[[Any], None]
"""Sends a person's wish to the program that runs the cell; from any thread."""
Open = Callable[[Scene, str, Any, int, Say], LiveView]
"""Opens a page, which may need its own kind of moment."""
Images = Callable[[], Iterable[Picture]]
"""Returns the images since the last call."""


def silent(scene: Scene, title: str, moment: Moment, port: int, say: Say) -> LiveView:
    """Open a page without controls."""
    del say
    return LiveView(scene, title, moment, port)


class LivePage:
    """A page in a process of its own; a context manager that ends it.

    Args:
        scene: of the cell; sent to the process.
        title: of the page.
        moment: the first one.
        port: as in ``LiveView``.
        listen: called in the process once a browser has opened the page, to receive images; None: no images.
        opens: opens the page, in the process.

    Attributes:
        port: the port that the server got.
        ended: whether the process was found to have ended.
    """

    def __init__(
        self,
        scene: Scene,
        title: str,
        moment: Moment,
        port: int = 8080,
        listen: Callable[[], Images] | None = None,
        opens: Open = silent,
    ):
        spawn = get_context("spawn")
        self._pipe, self._theirs = spawn.Pipe()
        given = (scene, title, moment, port, listen, opens, self._theirs)
        self._process = spawn.Process(target=show_for_ever, args=given, daemon=True)
        self._packed: SimpleQueue[memoryview | None] = SimpleQueue()
        self._sender = Thread(target=self._send, daemon=True)
        self._waits, self.port, self.ended = False, 0, False
        self._sent_s = time.monotonic()
        self._said: list[Any] = []

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
        self._sender.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._packed.put(None)
        self._sender.join(END_S)
        if self._sender.is_alive():
            self._process.kill()  # it has stopped reading
        self._pipe.close()
        self._process.join(END_S)
        self._process.kill()

    @property
    def waits(self) -> bool:
        """Return whether the page has shown the last moment; False once its process has ended."""
        self._listen()
        return self._waits

    @property
    def unanswered_s(self) -> float:
        """Return for how long the page has been busy with the last moment; 0 once it has shown it."""
        return 0.0 if self.waits else time.monotonic() - self._sent_s

    def said(self) -> list[Any]:
        """Return the wishes made on the page since the last call."""
        self._listen()
        said, self._said = self._said, []
        return said

    def _listen(self) -> None:
        try:
            while self._pipe.poll():
                answer = self._pipe.recv()
                if answer is True:
                    self._waits = True
                else:
                    self._said.append(answer)
        except (EOFError, OSError):
            self._waits, self.ended = False, True

    def show(self, moment: Moment) -> None:
        """Show a moment; to be called only if ``waits``, so that at most one is under way."""
        self._waits, self._sent_s = False, time.monotonic()
        self._packed.put(ForkingPickler.dumps(moment))  # now, since it may change before it is sent

    def _send(self) -> None:
        """Send packed moments; one with an image exceeds the pipe's buffer, and blocks until the process reads it."""
        while (packed := self._packed.get()) is not None:
            with suppress(OSError):  # the process has ended
                self._pipe.send_bytes(packed)


def show_for_ever(
    scene: Scene,
    title: str,
    moment: Moment,
    port: int,
    listen: Callable[[], Images] | None,
    opens: Open,
    pipe: Connection,
) -> None:
    """Show moments until the other end has gone; send the port first, then True after each moment."""
    lock = Lock()

    def say(what: object) -> None:
        with lock, suppress(OSError):  # the other end has gone
            pipe.send(what)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with its parent
    view = opens(scene, title, moment, port, say)
    os.nice(NICE if opens is silent else NICE_HEARD)
    images: Images | None = None
    look_s = 0.0
    try:
        say(view.port)
        while True:
            while not pipe.poll():
                time.sleep(PAUSE_S)
            view.show(pipe.recv())
            if not view.watched:
                pipe.poll(IDLE_S)  # a pause: nothing comes before the answer, unless the other end goes
            say(True)
            if time.monotonic() < look_s:
                continue
            look_s = time.monotonic() + LOOK_S
            if images is None and listen is not None and view.watched:
                images = listen()
            for picture in images() if images is not None else ():
                view.show_image(picture)
    except (EOFError, OSError):
        view.close()
