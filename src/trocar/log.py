"""The log of a cell's scripts, on the cell's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Span:
    """A stretch of one arm's time.

    Attributes:
        arm: the arm.
        name: what it did: capture, perception, planning, motion, jaw, settling.
        start_s: on the cell's clock.
        end_s: likewise.
    """

    arm: str
    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Computation:
    """The real time of one computation beside what its script declared.

    Attributes:
        name: what was computed.
        seconds: wall clock.
        budget_s: time that the cell's clock counted for it.
    """

    name: str
    seconds: float
    budget_s: float


@dataclass
class CellLog:
    """Spans, events and computations of one run of a cell.

    Attributes:
        clock: returns the cell's time in s.
        spans: in the order in which they ended.
        events: dicts with ``name``, ``time_s`` and what was noted.
        computations: in order.
        listener: called with each event, for a progress bar.
    """

    clock: Callable[[], float]
    spans: list[Span] = field(default_factory=list)
    events: list[dict[str, object]] = field(default_factory=list)
    computations: list[Computation] = field(default_factory=list)
    listener: Callable[[Mapping[str, object]], None] | None = None

    @contextmanager
    def span(self, arm: str, name: str) -> Iterator[None]:
        """Note the time from entering to leaving."""
        start = self.clock()
        try:
            yield
        finally:
            self.spans.append(Span(arm, name, round(start, 6), round(self.clock(), 6)))

    def event(self, name: str, **values: object) -> None:
        """Note something that happened now."""
        self.events.append({"name": name, "time_s": round(self.clock(), 6), **values})
        if self.listener is not None:
            self.listener(self.events[-1])

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Note the real time of a computation."""
        self.computations.append(Computation(name, seconds, budget_s))
