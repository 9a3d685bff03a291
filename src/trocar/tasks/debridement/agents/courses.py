"""The last motion of an arm in estimated joints, and the commands that were sent for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.cell import MotionResult
from trocar.trajectory import Trajectory

REST_STEP_S = 0.05
"""The rest of a motion is sampled at this interval when it is taken over."""
LATE_S = 0.25
"""Nothing is corrected within this time before the end of a motion."""


class Successor:
    """The result of commands that took over from others."""

    def __init__(self) -> None:
        self.ended = trio.Event()
        self.execution: MotionResult | None = None


@dataclass(eq=False)
class Course:
    """The last motion of an arm.

    Attributes:
        desired: motion of the estimated joints.
        commands: those sent for it, on the same time.
        stop_s: time of the motion at which it is going to be stopped; None: at its end.
        successor: corrected commands that took over, if any.
    """

    desired: Trajectory
    commands: Trajectory
    stop_s: float | None = None
    successor: Successor | None = None

    def drift(self, path_s: float) -> NDArray[np.float64]:
        """Return the change (6,) of estimated joints minus commands from its start to this time of it."""
        first = self.commands.times_s[0]
        return (self.desired(path_s) - self.commands(path_s)) - (self.desired(first) - self.commands(first))

    def left(self, path_s: float, rate: float) -> Course | None:
        """Return the rest of it from this time on, on the clock's time, for this rate; None near its end."""
        if (float(self.desired.times_s[-1]) - path_s) / rate < LATE_S:
            return None
        stop_s = None if self.stop_s is None else (self.stop_s - path_s) / rate
        return Course(_rest_of(self.desired, path_s, rate), _rest_of(self.commands, path_s, rate), stop_s)


def _rest_of(motion: Trajectory, path_s: float, rate: float) -> Trajectory:
    left_s = float(motion.times_s[-1]) - path_s
    times = np.linspace(path_s, motion.times_s[-1], max(2, int(np.ceil(left_s / REST_STEP_S)) + 1))
    return Trajectory.hermite((times - path_s) / rate, motion(times), rate * motion(times, 1))
