"""The process of the loop that drives real arms: nothing that a script computes can make it late."""

from __future__ import annotations

import contextlib
import importlib
import queue
import signal
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection

from trocar.errors import TrocarError
from trocar.hardware.arm import Connect, DrivenArm, LoopSettings
from trocar.hardware.loop import HardwareLoop
from trocar.hardware.messages import Close, Report
from trocar.hardware.priority import ahead_of_others

JITTER_SHARE = 0.1
"""A tick that is later than this share of its period postpones the next ones, so that no two come closer together."""
MAX_UNSENT = 1000
"""While this many reports wait to be sent, further ones are dropped unless a script may wait for them."""
LAST_WORDS_S = 0.5
FOR_THE_SCRIPT = ("SIGINT", "SIGHUP", "SIGQUIT", "SIGTSTP")
"""Ctrl-C, a closed terminal, Ctrl-backslash and Ctrl-Z are for the script, and the loop goes on: the script brakes the
arms, or the loop does when the script ends or falls silent."""


def serve(
    arms: Mapping[str, DrivenArm], connect: Connect, settings: LoopSettings, said: Connection, told: Connection
) -> None:
    """Run the loop's process: connect, then tick until told to close or the scripts' process has ended.

    Args:
        arms: by name.
        connect: connects one of them.
        settings: timing and tolerances.
        said: receives messages of the scripts' process.
        told: sends reports; the first message is None, or why the arms could not be connected.
    """
    for name in FOR_THE_SCRIPT:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    importlib.import_module("scipy.interpolate")  # takes .13 s: later, the first set-points would be old
    try:
        loop = HardwareLoop(arms, connect, settings)
    except Exception as error:
        told.send(error if isinstance(error, TrocarError) else f"{type(error).__name__}: {error}")
        return
    try:
        signal.signal(signal.SIGTERM, lambda *_: loop.inbox.put(Close()))
        told.send(None)
        with ahead_of_others(settings.priority):
            _tick_until_closed(loop, said, told)
    finally:  # a mistake in a driver or in the loop ends this process, and must not leave a connection open
        loop.close()


def _tick_until_closed(loop: HardwareLoop, said: Connection, told: Connection) -> None:
    """Let the loop tick on time, and pass on messages and reports."""
    unsent: queue.SimpleQueue[Report] = queue.SimpleQueue()
    settings = loop.settings
    threading.Thread(target=_listen, args=(said, loop.inbox), daemon=True).start()
    threading.Thread(target=_speak, args=(unsent, told), daemon=True).start()
    due_s = time.monotonic() + settings.tick_s
    while not loop.closed:
        time.sleep(max(0.0, due_s - time.monotonic()))
        now_s = time.monotonic()
        late_s = now_s - due_s
        report = loop.tick(late_s)
        if unsent.qsize() < MAX_UNSENT or report.eventful:
            unsent.put(report)
        due_s = (due_s if late_s < JITTER_SHARE * settings.tick_s else now_s) + settings.tick_s
    deadline_s = time.monotonic() + LAST_WORDS_S
    while not unsent.empty() and time.monotonic() < deadline_s:
        time.sleep(settings.tick_s)


def _listen(said: Connection, inbox: queue.SimpleQueue[object]) -> None:
    """Put messages into the inbox; None when the connection ends."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            inbox.put(said.recv())
    inbox.put(None)


def _speak(unsent: queue.SimpleQueue[Report], told: Connection) -> None:
    """Send reports, in a thread of their own: a frozen reader must not stop the loop."""
    with contextlib.suppress(OSError):
        while True:
            told.send(unsent.get())
