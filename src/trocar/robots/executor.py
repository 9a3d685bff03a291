"""What one arm is commanded at each moment: a motion played back, braked, or replaced while it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.cell import MotionEnd, SetPoint
from trocar.motion.brake import Brake, brake
from trocar.trajectory import Trajectory

DONE_S = 1e-6
"""A motion has ended when the clock is this close to its end, since durations are sums of floats."""


@dataclass
class _Motion:
    """A trajectory on the cell's clock.

    Attributes:
        trajectory: what is played.
        start_s: clock at which it began.
        braked: how it comes to rest, if it was told to, and since when.
        ended: how it will have ended, once it has.
        reason: why.
    """

    trajectory: Trajectory
    start_s: float
    braked: tuple[float, Brake] | None = None
    ended: MotionEnd = MotionEnd.DONE
    reason: str = ""

    @property
    def end_s(self) -> float:
        if self.braked is not None:
            return self.braked[0] + self.braked[1].duration_s
        return self.start_s + self.trajectory.duration_s


class TrajectoryExecutor:
    """The set-points of one arm over time.

    Args:
        model: of the arm.
        limits: within which it brakes.
        q: (6,) where it rests at first.
    """

    def __init__(self, model: ArmModel, limits: MotionLimits, q: NDArray[np.float64]):
        self._model, self._limits = model, limits
        self._rest = np.array(q, dtype=np.float64)
        self._motion: _Motion | None = None
        self._path = 0.0, True
        self._told: SetPoint | None = None  # as last asked for; None: the motion has changed since then

    @property
    def moving(self) -> bool:
        """Return whether a motion, or its braking, is running."""
        return self._motion is not None

    @property
    def braking(self) -> bool:
        """Return whether the motion is coming to rest before its end."""
        return self._motion is not None and self._motion.braked is not None

    def remaining(self, now_s: float, step_s: float) -> tuple[Trajectory, float] | None:
        """Return what is still being played and the clock at its start; None at rest.

        A braking motion is sampled in steps, because its own trajectory no longer tells when it is where.
        """
        motion = self._motion
        if motion is None:
            return None
        if motion.braked is None:
            return motion.trajectory, motion.start_s
        count = max(1, math.ceil((motion.end_s - now_s) / step_s))
        times = now_s + step_s * np.arange(count + 1.0)
        q, velocity, *_ = self._at(times)
        return Trajectory.hermite(times - now_s, q, velocity), now_s

    def start(self, trajectory: Trajectory, now_s: float) -> None:
        """Play a trajectory from now on, whatever was being played before."""
        self._motion, self._told = _Motion(trajectory, now_s), None

    def brake(self, now_s: float, ended: MotionEnd, reason: str) -> None:
        """Come to rest from now on; an arm that is already at rest or braking continues as it is."""
        motion = self._motion
        if motion is None or motion.braked is not None:
            return
        path_s = motion.trajectory.times_s[0] + min(now_s - motion.start_s, motion.trajectory.duration_s)
        motion.braked = (
            now_s,
            brake(motion.trajectory, float(path_s), self._limits, self._model.lower, self._model.upper),
        )
        motion.ended, motion.reason = ended, reason
        self._told = None

    def advance(self, now_s: float) -> tuple[MotionEnd, str] | None:
        """Return how a motion has ended, once it has; the arm rests from then on."""
        motion = self._motion
        if motion is None or now_s < motion.end_s - DONE_S:
            return None
        q, _, path_s, _, on_path = self._at(np.array([motion.end_s]))
        self._rest, self._path = q[0], (float(path_s[0]), on_path)
        self._motion = self._told = None
        return motion.ended, motion.reason

    def freeze(self, now_s: float) -> None:
        """Rest at once where the motion is, because nothing follows the set-points any more."""
        now = self.now(now_s)
        self._rest, self._path = now.q, (now.path_s, now.on_path)
        self._motion = self._told = None

    def samples(self, times_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return joints and velocities (n, 6) at these times of the clock, none in the past."""
        if self._motion is None:
            shape = (len(times_s), 6)
            return np.broadcast_to(self._rest, shape), np.zeros(shape)
        q, velocity, *_ = self._at(times_s)
        return q, velocity

    def now(self, now_s: float) -> SetPoint:
        """Return the command at this time of the clock; all callers within one tick get the same, read-only."""
        if self._told is None or self._told.time_s != now_s:
            self._told = self._set_point(now_s)
            self._told.q.flags.writeable = self._told.velocity.flags.writeable = False
        return self._told

    def _set_point(self, now_s: float) -> SetPoint:
        if self._motion is None:
            path_s, on_path = self._path
            return SetPoint(now_s, self._rest.copy(), np.zeros(6), False, path_s, 0.0, on_path)
        q, velocity, path_s, rate, on_path = self._at(np.array([now_s]))
        return SetPoint(now_s, q[0], velocity[0], True, float(path_s[0]), float(rate[0]), on_path)

    def _at(
        self, times_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], bool]:
        """Return joints, velocities, time along the path from its start, its rate; and whether the path is kept."""
        motion = self._motion
        assert motion is not None  # the callers make sure of this
        trajectory, first_s = motion.trajectory, motion.trajectory.times_s[0]
        if motion.braked is None:
            path_s = np.minimum(np.maximum(times_s - motion.start_s, 0.0), trajectory.duration_s)
            rate = np.where(times_s < motion.end_s - DONE_S, 1.0, 0.0)
        else:
            since, stop = times_s - motion.braked[0], motion.braked[1]
            path_s, rate = stop.at(since)
            path_s = path_s - first_s
            if stop.off_path is not None:
                return stop.off_path(since), stop.off_path(since, 1), path_s, rate, False
        at = first_s + path_s
        return trajectory(at), rate[:, None] * trajectory(at, 1), path_s, rate, True
