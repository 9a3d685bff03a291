"""A Ctrl-C that is not lost."""

from __future__ import annotations

import signal
import threading
from types import FrameType

FINALIZERS = ("weakref.py", "_weakrefset.py")
"""Files of the standard library whose callbacks swallow exceptions, as destructors do."""


class CtrlC:
    """Ctrl-C raises ``KeyboardInterrupt`` as usual, but not where Python would swallow it.

    Python swallows exceptions in destructors and in weak references' callbacks. There Ctrl-C is only noted; long work
    calls :meth:`check` now and then, which raises it.

    >>> with CtrlC() as ctrl_c:
    ...     for trial in trials:
    ...         ctrl_c.check()
    ...         run(trial)
    """

    def __init__(self) -> None:
        self._pressed = self._installed = False

    def __enter__(self) -> CtrlC:
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self)
            self._installed = True
        return self

    def __exit__(self, *_: object) -> None:
        if self._installed:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal."""
        del number
        self._pressed = True
        while frame is not None:
            if frame.f_code.co_name == "__del__" or frame.f_code.co_filename.endswith(FINALIZERS):
                return  # Python would swallow the exception here
            frame = frame.f_back
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise ``KeyboardInterrupt`` if Ctrl-C was pressed."""
        if self._pressed:
            raise KeyboardInterrupt


def interrupts() -> bool:
    """Return whether Ctrl-C raises ``KeyboardInterrupt`` in the thread that calls this."""
    handler = signal.getsignal(signal.SIGINT)
    ours = handler is signal.default_int_handler or isinstance(handler, CtrlC)
    return ours and threading.current_thread() is threading.main_thread()
