"""The set-points of one arm: from a trajectory that is executed, braked, or replaced while it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trocar.arms import ArmModel, MotionLimits
from trocar.cell import MotionEnd, SetPoint
from trocar.errors import TrocarError
from trocar.geometry.arrays import Array
from trocar.motion.brake import Brake, brake
from trocar.trajectory import Trajectory

DONE_S = 1e-6
"""A motion has ended when the clock is this close to its end, since durations are sums of floats."""


class Ending(NamedTuple):
    """How a motion has ended, and why; no cause if it ran to its end."""

    ended: MotionEnd = MotionEnd.DONE
    cause: TrocarError | None = None


class _State(NamedTuple):
    """Joints and velocities (n, 6), time along the path and its rate (n,), and whether the arm is on the path."""

    q: Array
    velocity: Array
    path_s: Array
    rate: Array
    on_path: bool


@dataclass
class _Motion:
    """A trajectory on the cell's clock, and the ending to report once it is over."""

    trajectory: Trajectory
    start_s: float
    braked: tuple[float, Brake] | None = None  # since when it comes to rest, and how
    ending: Ending = Ending()

    @property
    def end_s(self) -> float:
        if self.braked is not None:
            return self.braked[0] + self.braked[1].duration_s
        return self.start_s + self.trajectory.duration_s

    def at(self, times_s: Array) -> _State:
        """Return the state at these times of the clock."""
        trajectory, first_s = self.trajectory, self.trajectory.times_s[0]
        if self.braked is None:
            path_s = np.minimum(np.maximum(times_s - self.start_s, 0.0), trajectory.duration_s)
            rate = np.where(times_s < self.end_s - DONE_S, 1.0, 0.0)
        else:
            since, stop = times_s - self.braked[0], self.braked[1]
            path_s, rate = stop.at(since)
            path_s = path_s - first_s
            if stop.off_path is not None:
                return _State(stop.off_path(since), stop.off_path(since, 1), path_s, rate, False)
        at = first_s + path_s
        return _State(trajectory(at), rate[:, None] * trajectory(at, 1), path_s, rate, True)


class TrajectoryExecutor:
    """The set-points of one arm over time.

    Args:
        model: of the arm.
        limits: within which it brakes.
        q: (6,) where it rests at first.
    """

    def __init__(self, model: ArmModel, limits: MotionLimits, q: Array):
        self._model, self._limits = model, limits
        self._rest = np.array(q, dtype=np.float64)
        self._motion: _Motion | None = None
        self._path = 0.0, True
        self._setpoint: SetPoint | None = None  # cached for one tick; None: the motion has changed since

    @property
    def moving(self) -> bool:
        """Return whether a motion, or its braking, is running."""
        return self._motion is not None

    @property
    def braking(self) -> bool:
        """Return whether the motion is coming to rest before its end."""
        return self._motion is not None and self._motion.braked is not None

    def remaining(self, now_s: float, step_s: float) -> tuple[Trajectory, float] | None:
        """Return the trajectory being executed and its start on the clock; None at rest.

        A braking motion is sampled in steps, because it no longer follows the timing of its trajectory.
        """
        motion = self._motion
        if motion is None:
            return None
        if motion.braked is None:
            return motion.trajectory, motion.start_s
        count = max(1, math.ceil((motion.end_s - now_s) / step_s))
        times = now_s + step_s * np.arange(count + 1.0)
        state = motion.at(times)
        return Trajectory.hermite(times - now_s, state.q, state.velocity), now_s

    def start(self, trajectory: Trajectory, now_s: float) -> None:
        """Execute a trajectory from now on, whatever was executed before."""
        self._motion, self._setpoint = _Motion(trajectory, now_s), None

    def brake(self, now_s: float, ending: Ending) -> None:
        """Start to brake; does nothing if the arm is already at rest or braking."""
        motion = self._motion
        if motion is None or motion.braked is not None:
            return
        path_s = motion.trajectory.times_s[0] + min(now_s - motion.start_s, motion.trajectory.duration_s)
        stop = brake(motion.trajectory, float(path_s), self._limits, self._model.lower, self._model.upper)
        motion.braked, motion.ending, self._setpoint = (now_s, stop), ending, None

    def advance(self, now_s: float) -> Ending | None:
        """Return the ending of a motion that is over, and rest from then on; None if it is not over, or at rest."""
        motion = self._motion
        if motion is None or now_s < motion.end_s - DONE_S:
            return None
        state = motion.at(np.array([motion.end_s]))
        self._rest, self._path = state.q[0], (float(state.path_s[0]), state.on_path)
        self._motion = self._setpoint = None
        return motion.ending

    def freeze(self, now_s: float) -> None:
        """Rest at once where the motion is, because nothing follows the set-points any more."""
        now = self.now(now_s)
        self._rest, self._path = now.q, (now.path_s, now.on_path)
        self._motion = self._setpoint = None

    def samples(self, times_s: Array) -> tuple[Array, Array]:
        """Return joints and velocities (n, 6) at these times of the clock, none in the past."""
        if self._motion is None:
            shape = (len(times_s), 6)
            return np.broadcast_to(self._rest, shape), np.zeros(shape)
        state = self._motion.at(times_s)
        return state.q, state.velocity

    def now(self, now_s: float) -> SetPoint:
        """Return the command at this time of the clock; all callers within one tick share one read-only value."""
        if self._setpoint is None or self._setpoint.time_s != now_s:
            if self._motion is None:
                path_s, on_path = self._path
                q, velocity, rate = self._rest.copy(), np.zeros(6), 0.0
            else:
                state = self._motion.at(np.array([now_s]))
                q, velocity, on_path = state.q[0], state.velocity[0], state.on_path
                path_s, rate = float(state.path_s[0]), float(state.rate[0])
            q.flags.writeable = velocity.flags.writeable = False
            self._setpoint = SetPoint(now_s, q, velocity, self.moving, path_s, rate, on_path)
        return self._setpoint
