"""How regularly a served cell's ticks come, published as a da Vinci Research Kit does for its arms."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from trocar.crtk.bus import Bus, stamped
from trocar.crtk.messages import IntervalStatistics

EVERY_S = 1.0


class Periods:
    """Publishes statistics of each second's ticks on ``period_statistics`` of each arm.

    Args:
        bus: where to publish.
        topics: the arms' namespaces.
    """

    def __init__(self, bus: Bus, topics: Sequence[str]):
        self._out = [bus.publisher(f"{topic}/period_statistics", IntervalStatistics) for topic in topics]
        self._last_s: float | None = None
        self._usual_s = float("inf")
        self._ticks: list[tuple[float, float]] = []

    @contextmanager
    def tick(self) -> Iterator[None]:
        """Measure the period of a tick, and the time that the block takes."""
        began_s = time.perf_counter()
        yield
        if self._last_s is not None:
            self._ticks.append((began_s - self._last_s, time.perf_counter() - began_s))
        self._last_s = began_s
        if sum(period_s for period_s, _ in self._ticks) >= EVERY_S:
            self._tell(np.array(self._ticks))
            self._ticks.clear()

    def _tell(self, ticks: np.ndarray) -> None:
        """Publish the mean, deviation and range of periods and computing times, (n, 2), s."""
        figures = np.stack([ticks.mean(axis=0), ticks.std(axis=0), ticks.min(axis=0), ticks.max(axis=0)], axis=1)
        overruns = int((ticks[:, 1] > self._usual_s).sum())
        self._usual_s = figures[0, 0]
        told = IntervalStatistics(
            stamped(),
            *figures.ravel().tolist(),
            number_of_samples=len(ticks),
            number_of_overruns=overruns,
            statistics_interval=float(ticks[:, 0].sum()),
        )
        for out in self._out:
            if out.readers():
                out.send(told)
