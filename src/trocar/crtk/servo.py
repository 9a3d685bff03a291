"""What an arm that is streamed to does with its set-points: play them back a little later, within its limits."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.robots import TICK_S
from trocar.trajectory import Trajectory

DELAY_S = 2 * TICK_S
"""Set-points are played back this much later, so that neither a late message nor two at once make an arm jerk."""
ALONE_S = 0.1
"""A set-point that comes later than this after the one before is not of the same stream."""
PAUSE_S = 1.0
"""After so long without a set-point the clocks of sender and receiver are compared anew."""
INTERVALS = 50
"""The median of so many intervals is a stream's period."""
UNEVEN_S = DELAY_S / 2
"""A set-point of a moving stream that is less out of step than this is played back in step. A sender's timer errs by
fractions of a millisecond, which would look like jumps of speed: at 1 ms of them, an arm that braked as hard as its
limits allow missed its goal by up to 3 mm."""
MAX_DRIFT = 0.002
"""Share of the period by which the step may then change, to follow the sender's clock."""


class SetPoints:
    """A stream of set-points, played back as its sender timed it.

    Their stamps say how far they are apart; the fastest of them to arrive says how the sender's clock differs from
    this machine's. Without stamps, their arrival counts. While a stream moves, it is played back at an even pace.
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
            now: (joints,) where the arm is, from where the first one is reached.
            came_s: clock of this machine.
            stamp_s: clock of its sender, if it is known.
        """
        last_s, last = self._points[-1] if self._points else (-np.inf, now)
        if came_s - last_s > PAUSE_S:
            self._ahead_s = np.inf
        at_s = came_s
        if stamp_s is not None:
            self._ahead_s = min(self._ahead_s, came_s - stamp_s)
            at_s = stamp_s + self._ahead_s
        interval_s, self._came_s = at_s - self._came_s, at_s
        if at_s - last_s > ALONE_S:  # from where the arm waits, within a tick
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
        """Return when to play back what is due at this time, a period after the one before."""
        period_s = float(np.median(self._intervals_s))
        off_s = at_s - last_s - period_s
        drift_s = MAX_DRIFT * period_s
        return last_s + period_s + min(max(off_s, -drift_s), drift_s) if abs(off_s) < UNEVEN_S else at_s

    def clear(self) -> None:
        """Forget all of them."""
        self._points.clear()


def step_towards(
    goal: NDArray[np.float64],
    goal_velocity: NDArray[np.float64],
    q: NDArray[np.float64],
    velocity: NDArray[np.float64],
    limits: MotionLimits,
) -> Trajectory:
    """Return a motion that follows a goal for a tick, as near as the limits allow, and comes to rest after that.

    A goal that itself keeps the limits is followed, as the quadratic B-spline of its ticks does: exactly where it is at
    rest or its speed is constant, and half a tick late. One that jumps, or was not heard of for a while, is caught up
    with as fast as can be without overshoot. The motion's end takes place only if no other takes over: a stream that
    breaks off ends within limits.

    Args:
        goal: (joints,) a tick from now.
        goal_velocity: (joints,) with which it moves during the tick.
        q: (joints,) now.
        velocity: (joints,) now.
        limits: of the arm.
    """
    change = limits.acceleration * TICK_S
    point = q + velocity * TICK_S / 2  # of the B-spline
    off = goal - (point + goal_velocity * TICK_S)
    # both would stop at the same place, braking as hard as the limits allow: so nothing is overshot if the goal does
    wanted = _speed_over(off + _stopped_after(goal_velocity, change), change)
    after = np.clip(np.clip(wanted, velocity - change, velocity + change), -limits.velocity, limits.velocity)
    stop_s = max(float((np.abs(after) / limits.acceleration).max()), TICK_S)
    end = q + (velocity + after) * TICK_S / 2
    tick = np.stack([(after - velocity) / (2 * TICK_S), velocity, q])
    stop = np.stack([-after / (2 * stop_s), after, end])
    return Trajectory(np.array([0.0, TICK_S, TICK_S + stop_s]), np.stack([tick, stop], axis=1))


def _stopped_after(velocity: NDArray[np.float64], change: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far (joints,) whole ticks at speeds v, v - change, v - 2 change ... lead, until they are at rest."""
    steps = np.abs(velocity) / change
    n = np.floor(steps)
    return np.sign(velocity) * change * TICK_S * (n + 1) * (steps - n / 2)


def _speed_over(distance: NDArray[np.float64], change: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the speed (joints,) that is at rest after this distance: the inverse of ``_stopped_after``."""
    share = np.abs(distance) / (change * TICK_S)
    n = np.floor((np.sqrt(1 + 8 * share) - 1) / 2)
    return np.sign(distance) * change * (share / (n + 1) + n / 2)
