"""The log of a cell's scripts on the cell's clock, and computation times that are comparable between machines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from trocar.perception.image import Image

Result = TypeVar("Result")

REFERENCE_S = 6.75e-3
"""Time of ``_reference``, in s, on the machine for which the agents' budgets were declared: there the paper's SQP takes
.3 s per motion. Scaled from a machine on which they take 7.2 ms and .32 s (``bench_planning.py``)."""
REPEATS = 7


@dataclass(frozen=True)
class Span:
    """A stretch of one arm's time.

    Attributes:
        arm: the arm.
        name: what it did: capture, perception, planning, motion, jaw, settling.
        start_s: when it began, on the cell's clock.
        end_s: when it ended.
    """

    arm: str
    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Computation:
    """The measured time of one computation, and the time that its script declared.

    Attributes:
        name: what was computed.
        seconds: computation time on this machine, as ``timed`` measures it.
        budget_s: time that the cell's clock counted for it.
    """

    name: str
    seconds: float
    budget_s: float


@dataclass(frozen=True, eq=False)
class Sighting:
    """What perception found in an image.

    Attributes:
        image: the image.
        outlines_m: closed outline (n, 3) of each object found, by its name, in the frame of the (left) camera.
    """

    image: Image
    outlines_m: Mapping[str, NDArray[np.float64]]


@dataclass
class CellLog:
    """Spans, events and computations of one run of a cell.

    Attributes:
        clock: returns the cell's time in s.
        spans: in the order in which they ended.
        begun: spans that have not ended: arm, name and start.
        events: dicts with ``name``, ``time_s`` and what was noted.
        computations: in order.
        samples: rows of numbers of each series.
        sightings: the latest sighting of each camera, for live views; not saved with the trial.
        listener: called with each event, for a progress bar.
    """

    clock: Callable[[], float]
    spans: list[Span] = field(default_factory=list)
    begun: list[tuple[str, str, float]] = field(default_factory=list)
    events: list[dict[str, object]] = field(default_factory=list)
    computations: list[Computation] = field(default_factory=list)
    samples: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    sightings: dict[str, Sighting] = field(default_factory=dict)
    listener: Callable[[Mapping[str, object]], None] | None = None

    @contextmanager
    def span(self, arm: str, name: str) -> Iterator[None]:
        """Record a span from entering to leaving the context."""
        begun = arm, name, round(self.clock(), 6)
        self.begun.append(begun)
        try:
            yield
        finally:
            self.begun.remove(begun)
            self.spans.append(Span(*begun, round(self.clock(), 6)))

    def event(self, name: str, **values: object) -> None:
        """Record an event at the present time; :func:`plain` converts its values."""
        noted = {key: plain(value) for key, value in values.items()}
        self.events.append({"name": name, "time_s": round(self.clock(), 6), **noted})
        if self.listener is not None:
            self.listener(self.events[-1])

    def sample(self, name: str, row: NDArray[np.float64]) -> None:
        """Add a row of numbers to a series."""
        self.samples.setdefault(name, []).append(np.array(row, dtype=np.float64))

    def saw(self, camera: str, image: Image, outlines_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Record what perception found in an image of a camera (see ``Sighting``)."""
        self.sightings[camera] = Sighting(image, outlines_m)

    @property
    def series(self) -> dict[str, NDArray[np.float32]]:
        """Return each series as an array, one row per sample."""
        return {name: np.array(rows, dtype=np.float32) for name, rows in self.samples.items()}

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Record the measured time of a computation."""
        self.computations.append(Computation(name, seconds, budget_s))


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: NaN and infinity become None, unknown types their ``str``."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        items = [plain(item) for item in value]
        return tuple(items) if isinstance(value, tuple) else items
    return value if isinstance(value, str | int | None) else str(value)


def timed(function: Callable[[], Result]) -> tuple[Result, float]:
    """Return a function's result and its computation time, in s.

    This is the wall-clock time or the process's CPU time, whichever is shorter: neither waiting for other programs nor
    using several cores makes a computation slower. It is at least the thread's CPU time, because the process's CPU
    clock stands still for milliseconds where CPU time is limited (``ulimit -t``, clusters).
    """
    wall_s, processor_s, thread_s = time.perf_counter(), time.process_time(), time.thread_time()
    result = function()
    thread_s, processor_s = time.thread_time() - thread_s, time.process_time() - processor_s
    return result, max(thread_s, min(time.perf_counter() - wall_s, processor_s))


@cache
def machine_speed() -> float:
    """Return how fast this machine computes, as a multiple of the one for which budgets were declared.

    Measured once per process, by a few milliseconds of what agents compute most.
    """
    return REFERENCE_S / min(timed(_reference)[1] for _ in range(REPEATS))


def _reference() -> None:
    """Find nearest points, solve a small linear system, and take many small steps, as perception and planners do."""
    rng, q = np.random.default_rng(0), np.zeros(6)
    points, matrix = rng.standard_normal((3000, 3)), rng.standard_normal((60, 60)) + 60.0 * np.eye(60)
    turn = np.linalg.qr(matrix[:3, :3])[0]
    for _ in range(60):
        points = points @ turn
        nearest = np.argmin(np.linalg.norm(points - q[:3], axis=1))
        solved = np.linalg.solve(matrix, matrix[:, :6])
        for _ in range(20):
            q = np.sin(solved[:6]) @ q + 1e-3 * points[nearest, 0]
