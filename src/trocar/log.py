"""The log of a cell's scripts, on the cell's clock; and how long computations take, comparable between machines."""

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
"""Time of ``_reference`` on the machine for which the agents' budgets were declared, where the paper's SQP takes .3 s
per motion. Measured on another one, where they take 7.2 ms and .32 s (``bench_planning.py``)."""
REPEATS = 7


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
        seconds: as ``timed`` measures it, on the machine that computed.
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
        outlines_m: a closed line (n, 3) about each thing that was found, in m, in the frame of the camera (of the left
            one, if there are two), by what it is.
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
        sightings: what was found last in an image of each camera, for whoever watches: it is in no trial.
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
        """Note the time from entering to leaving."""
        begun = arm, name, round(self.clock(), 6)
        self.begun.append(begun)
        try:
            yield
        finally:
            self.begun.remove(begun)
            self.spans.append(Span(*begun, round(self.clock(), 6)))

    def event(self, name: str, **values: object) -> None:
        """Note something that happened now; NumPy's numbers become plain ones, those that are not finite None."""
        noted = {key: plain(value) for key, value in values.items()}
        self.events.append({"name": name, "time_s": round(self.clock(), 6), **noted})
        if self.listener is not None:
            self.listener(self.events[-1])

    def sample(self, name: str, row: NDArray[np.float64]) -> None:
        """Add a row of numbers to a series."""
        self.samples.setdefault(name, []).append(np.array(row, dtype=np.float64))

    def saw(self, camera: str, image: Image, outlines_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Note what perception found in an image of a camera, as in ``Sighting``."""
        self.sightings[camera] = Sighting(image, outlines_m)

    @property
    def series(self) -> dict[str, NDArray[np.float32]]:
        """Return each series as an array, a row a sample."""
        return {name: np.array(rows, dtype=np.float32) for name, rows in self.samples.items()}

    def compute(self, name: str, seconds: float, budget_s: float) -> None:
        """Note the real time of a computation."""
        self.computations.append(Computation(name, seconds, budget_s))


def plain(value: Any) -> Any:
    """Return what JSON can hold of a value, None for numbers that are not finite: it is saved whatever it is."""
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
    """Return a function's result and how long it computed, in s.

    That is the wall-clock time, or the processor's time if it is shorter: a computation does not become slower when
    other programs keep it waiting, nor when it uses several processors. The thread's own time is the least, because the
    process's clock stands still for milliseconds where a process's time is limited (``ulimit -t``, clusters).
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
