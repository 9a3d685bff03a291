"""Detects that the page with the controls has frozen: it would keep its connection for most of a minute."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

EVERY_S = 0.5
"""Time between an answer and the next question."""
LIMIT_S = 2.0
"""A page that has answered fast counts as silent after this time without an answer, .."""
SLOWER, KEPT = 10.0, 10
""".. and a slow one after ``SLOWER`` times the longest of its last ``KEPT`` response times. A browser without a
graphics card, on two shared cores, took 0.3 to 13 s, sometimes 3 times as long as before."""
LOOK_S = 0.1
KEY = "trocar"
"""Key in the browser's local storage that nobody sets: the page's script must run to look it up."""


@dataclass(eq=False)
class _Question:
    """A question that waits for its answer: to which page, and for how long."""

    page: Any
    waited_s: float = 0.0


class Pulse:
    """Asks a page repeatedly for something that only its script can answer.

    A page counts as still being built, and never as silent, until it has answered ``KEPT`` times. A page in a hidden
    tab answers too. Time in which this process itself did not run does not count.

    Args:
        holder: returns viser's handle of the page to ask; None: there is none.
        missed: called once when the page falls silent; again only after it has answered.

    Attributes:
        limit_s: time limit for an answer; inf while the page is being built.
        silent: handle of the page that fell silent and has not answered since.
    """

    def __init__(self, holder: Callable[[], Any], missed: Callable[[], None]):
        self._holder, self._missed = holder, missed
        self._question: _Question | None = None
        self.limit_s, self.silent = math.inf, None
        self._ended = threading.Event()
        for run in (self._ask, self._look):
            threading.Thread(target=run, daemon=True).start()

    def end(self) -> None:
        """Stop asking."""
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
            except RuntimeError:  # the page has gone, or it has answered that its browser has no storage
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
