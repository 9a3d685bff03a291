"""Handle Ctrl-C while a cell runs, and scripts that let no time pass."""

from __future__ import annotations

import _thread
import logging
import signal
import sys
import sysconfig
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from trocar.interruption import interrupts

LOOK_S = 0.25
"""Wall-clock time between two looks at the cell's clock."""
PATIENCE_S = 0.5
"""After Ctrl-C, a script that lets no time pass for this long is ended at whatever line it is."""
WARNING_S = 10.0
"""A warning names a script that lets no time pass for this long."""

PACKAGE = str(Path(__file__).parents[1])
RUNNER = f"{PACKAGE}/sim/laboratory.py"
LIBRARIES = tuple(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))


class Watchdog:
    """Ends a running cell on Ctrl-C.

    The first Ctrl-C only sets :attr:`asked`: the cell reads it at its next tick and ends its scripts there. If no tick
    comes, because a script computes or loops, the watchdog raises ``KeyboardInterrupt`` in the script, and again if
    something swallows it, as Python does in a destructor. Outside the main thread, and where another handler takes
    Ctrl-C, the watchdog does nothing.

    Args:
        now_s: returns the time of the cell's clock.
        in_script: returns whether a script runs now, rather than the physics, a camera's rendering or the braking of
            the arms.

    Attributes:
        asked: whether Ctrl-C was pressed.
        where: the line of a script that was ended for letting no time pass; empty otherwise.
    """

    def __init__(self, now_s: Callable[[], float], in_script: Callable[[], bool]):
        self._now_s, self._in_script = now_s, in_script
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._main = threading.get_ident()
        self._before = signal.getsignal(signal.SIGINT)
        self.asked, self.where = False, ""

    def __enter__(self) -> Watchdog:
        if interrupts():
            signal.signal(signal.SIGINT, self._on_ctrl_c)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()
            signal.signal(signal.SIGINT, self._before)

    def _on_ctrl_c(self, number: int, frame: FrameType | None) -> None:
        del number
        if not self.asked:
            self.asked = True
        elif self._in_script() and frame is not None and "trio" not in Path(frame.f_code.co_filename).parts:
            self.where = line_of_script(frame)
            raise KeyboardInterrupt

    def _watch(self) -> None:
        idle_s, last_s, told = 0.0, self._now_s(), False
        while not self._over.wait(LOOK_S):
            if self._now_s() != last_s:
                idle_s, last_s, told = 0.0, self._now_s(), False
                continue
            idle_s += LOOK_S if self._in_script() else 0.0
            if self.asked and idle_s >= PATIENCE_S:
                _thread.interrupt_main()  # calls the handler again, in the main thread
            elif idle_s >= WARNING_S and not told and self._in_script():
                told = True
                line = line_of_script(sys._current_frames().get(self._main))  # no public function does this
                logging.getLogger("trocar").warning(
                    "a script has let no time pass for %.0f s: %s; Ctrl-C ends it", idle_s, line or "in a library"
                )


def line_of_script(frame: FrameType | None) -> str:
    """Return file and line of a user's file that runs, or else of a task's; empty if neither does.

    The program that runs the cell is no script: its files are not named.
    """
    ours = ""
    while frame is not None:
        file = frame.f_code.co_filename
        if file == RUNNER and frame.f_code.co_name == "run":
            break
        line = f"{file}, line {frame.f_lineno}"
        if file.startswith(f"{PACKAGE}/tasks"):
            ours = ours or line
        elif not file.startswith((PACKAGE, *LIBRARIES, "<")):
            return line
        frame = frame.f_back
    return ours
