"""Playback of the set-points that are streamed to an arm: a little later, at their sender's pace."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from trocar.robots import TICK_S

DELAY_S = 2 * TICK_S
"""Set-points are played back this much later, so that neither a late message nor two at once make an arm jerk."""
ALONE_S = 0.1
"""A set-point that comes this long after the one before begins a new stream."""
PAUSE_S = 1.0
"""After so long without a set-point the clocks of sender and receiver are compared anew."""
INTERVALS = 50
"""Number of intervals whose median is a stream's period."""
UNEVEN_S = DELAY_S / 2
"""A set-point of a moving stream that is less out of step than this is played back in step. A sender's timer errs by
fractions of a millisecond, which would look like jumps of speed: at 1 ms of them, an arm that braked as hard as its
limits allow missed its goal by up to 3 mm."""
MAX_DRIFT = 0.002
"""Share of the period by which the step may then change, to follow the sender's clock."""


class SetPoints:
    """A stream of set-points, played back as its sender timed it.

    Stamps give the intervals, and the set-point that arrived fastest gives the offset of the sender's clock. Without
    stamps, arrival times count. While a stream moves, it is played back at an even pace.
    """

    def __init__(self) -> None:
        self._points: deque[tuple[float, NDArray[np.float64]]] = deque()
        self._intervals_s: deque[float] = deque(maxlen=INTERVALS)
        self._came_s, self._ahead_s = -np.inf, np.inf

    def add(
        self, q: NDArray[np.float64], now: NDArray[np.float64], came_s: float, stamp_s: float | None
    ) -> NDArray[np.float64]:
        """Take a set-point; return the speeds (joints,) that reaching it from the one before takes.

        Args:
            q: (joints,) where to be.
            now: (joints,) where the arm is, from which the first set-point is reached.
            came_s: time of arrival on this machine's clock.
            stamp_s: stamp on the sender's clock; None: unknown.
        """
        last_s, last = self._points[-1] if self._points else (-np.inf, now)
        if came_s - last_s > PAUSE_S:
            self._ahead_s = np.inf
        at_s = came_s
        if stamp_s is not None:
            self._ahead_s = min(self._ahead_s, came_s - stamp_s)
            at_s = stamp_s + self._ahead_s
        interval_s, self._came_s = at_s - self._came_s, at_s
        if at_s - last_s > ALONE_S:  # a new stream: from where the arm waits, within a tick
            last_s = at_s - TICK_S
            self._points.append((last_s, last))
            self._intervals_s.clear()
        else:
            self._intervals_s.append(interval_s)
            if (q != last).any():
                at_s = self._in_step(at_s, last_s)
        at_s = max(at_s, last_s)
        self._points.append((at_s, q))
        return np.abs(q - last) / max(at_s - last_s, TICK_S)

    def at(self, now_s: float) -> NDArray[np.float64] | None:
        """Return where to be now; None where nothing has been streamed."""
        play_s = now_s - DELAY_S
        while len(self._points) > 1 and self._points[1][0] <= play_s:
            self._points.popleft()
        if not self._points:
            return None
        first_s, first = self._points[0]
        if len(self._points) == 1 or play_s <= first_s:
            return first
        next_s, following = self._points[1]
        return first + (following - first) * ((play_s - first_s) / (next_s - first_s))

    def _in_step(self, at_s: float, last_s: float) -> float:
        """Return when to play back a set-point due at ``at_s``: a period after the last, unless that is far off."""
        period_s = float(np.median(self._intervals_s))
        off_s = at_s - last_s - period_s
        drift_s = MAX_DRIFT * period_s
        return last_s + period_s + min(max(off_s, -drift_s), drift_s) if abs(off_s) < UNEVEN_S else at_s

    def clear(self) -> None:
        """Forget all set-points."""
        self._points.clear()
