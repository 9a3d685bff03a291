"""Whether the page that a person holds still answers: a frozen one keeps its connection for most of a minute."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

EVERY_S = 0.5
"""Between an answer and the next question."""
LIMIT_S = 2.0
"""A page that answered soon until now is missed after this time, .."""
SLOWER, KEPT = 10.0, 10
""".. and a slow one after so many times the longest that it took for its last answers, this many. A browser that draws
without a graphics card, on two cores that others use, answered within .3 to 13 s; 3 times later than before as well."""
LOOK_S = 0.1
KEY = "trocar"
"""Of a value that the browser would keep, and nobody sets: to look for it, the page's script has to run."""


@dataclass(eq=False)
class _Question:
    """One that waits for its answer: of which page, and for how long."""

    page: Any
    waited_s: float = 0.0


class Pulse:
    """Asks a page again and again for something that only its script can answer.

    A page that has not answered ``KEPT`` times yet is still being built, and is not missed; one in a hidden tab
    answers. Time in which this process itself did not run does not count.

    Args:
        holder: returns viser's handle of the page that is asked; None: there is none.
        missed: is called once when it does not answer any more; again only after it has answered.

    Attributes:
        limit_s: within this time the page has to answer; inf: it is still being built.
        silent: handle of the page that was missed, and has not answered since.
    """

    def __init__(self, holder: Callable[[], Any], missed: Callable[[], None]):
        self._holder, self._missed = holder, missed
        self._question: _Question | None = None
        self.limit_s, self.silent = math.inf, None
        self._ended = threading.Event()
        for run in (self._ask, self._look):
            threading.Thread(target=run, daemon=True).start()

    def end(self) -> None:
        """Ask no more."""
        self._ended.set()

    def _ask(self) -> None:
        asked, late_s = None, deque[float](maxlen=KEPT)
        while not self._ended.wait(EVERY_S):
            page = self._holder()
            if page is not asked:
                asked, self.limit_s = page, math.inf
                late_s.clear()
            if page is None:
                continue
            self._question = question = _Question(page)
            try:
                page.local_storage.get_item(KEY)
            except RuntimeError:  # the page has gone, or its browser keeps no values, which it has told
                if self._holder() is not page:
                    continue
            finally:
                self._question = None
            late_s.append(min(question.waited_s, self.limit_s))
            self.silent = None
            if len(late_s) == KEPT:
                self.limit_s = max(LIMIT_S, SLOWER * max(late_s))

    def _look(self) -> None:
        before = time.monotonic()
        while not self._ended.wait(LOOK_S):
            now = time.monotonic()
            question = self._question
            if question is not None:
                question.waited_s += min(now - before, 2 * LOOK_S)
                if question.waited_s > self.limit_s and self.silent is not question.page:
                    self.silent = question.page
                    self._missed()
            before = now
