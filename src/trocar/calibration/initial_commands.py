"""A rough version of a motion's commands, without limits: the model inverted at some of its points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.calibration.command_request import CommandRequest
from trocar.calibration.compensation import inverse, sample_positions
from trocar.calibration.limited_paths import HEADROOM
from trocar.calibration.quadratic import QuadraticSpline
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

KNOT_S = (0.010, 0.025)
"""Least and greatest spacing of the commands' knots: from one control period to a tenth of the time needed to cross the
widest slack."""
KNOTS = (12, 48)
"""A short motion has at least the first number of intervals; a longer one gets up to the second before they get
longer."""

SKETCH_S = 0.060
"""Initial spacing of the points at which the model is inverted, one after the other."""
SKETCHED = 4
"""Minimum number of these points."""
SKETCH_RAD = 1e-3
"""Accuracy of the inversion; refinement does the rest."""

RESTING_S = 1e-4
"""A joint that could be stopped in less than this counts as resting."""


@dataclass(frozen=True, eq=False)
class InitialCommands:
    """A request with a rough version of its commands, without limits.

    Attributes:
        request: whose desired joints end at rest.
        lower: (6,) least commands that are allowed, room to brake included.
        upper: (6,) greatest.
        shares: (k,) points, as shares of the motion's time.
        correction: (k, 6) commands minus desired joints.
        given_up: (k, 6) part of the desired joints that is given up because commands may not leave their ranges.
        farthest: (6,) each joint's farthest command towards or beyond the ends of its range, had it none.
        end: (6,) last command.
    """

    request: CommandRequest
    lower: Array
    upper: Array
    shares: Array
    correction: Array
    given_up: Array
    farthest: Array
    end: Array

    def at(self, shares: Array, rows: Array) -> Array:
        """Return rows (k, 6) of this sketch at other shares (n,) of the time: (n, 6)."""
        return np.column_stack([np.interp(shares, self.shares, column) for column in rows.T])

    def min_stretch(self) -> float:
        """Return the least factor by which to slow down, for the way to the last command to keep the accelerations."""
        request, knots = self.request, knots_of(self.request.desired)
        spare = 1.0 - 2.0 * HEADROOM
        limits = MotionLimits(spare * request.limits.velocity, spare * request.limits.acceleration)
        way, speed = self.end - request.q_start, request.velocity_start

        def suffices(factor: float) -> bool:
            spline = QuadraticSpline(factor * knots)
            if np.any(np.abs(speed) > limits.acceleration * spline.times_s[-1]):
                return False
            reach, back = spline.reach(speed, limits), -spline.reach(-speed, limits)
            return bool(np.all((back - 1e-12 <= way) & (way <= reach + 1e-12)))

        high = 1.0
        while not suffices(high):
            high *= 2.0
        low = high / 2.0
        while high > 1.0 and high - low > 1e-3 * low:
            middle = (low + high) / 2
            low, high = (low, middle) if suffices(middle) else (middle, high)
        return high


def _braked(desired: Trajectory, limits: MotionLimits) -> Trajectory:
    """Return the motion from time 0; joints still moving at its end go straight on until all come to rest together."""
    desired = Trajectory(desired.times_s - desired.times_s[0], desired.coefficients)
    q, v = desired(desired.times_s[-1]), desired(desired.times_s[-1], 1)
    duration = float(np.max(np.abs(v) / limits.acceleration))
    if duration < RESTING_S:
        return desired
    return desired.then(Trajectory(np.array([0.0, duration]), np.stack([-v / (2 * duration), v, q])[:, None]))


def sketched(request: CommandRequest) -> InitialCommands:
    """Return the sketch: the model inverted at some points of the motion, one after the other."""
    lower, upper = _ranges(request)
    desired, model = _braked(request.desired, request.limits), request.memory.model
    count = max(SKETCHED, int(np.ceil(desired.duration_s / SKETCH_S)))
    times, wanted = desired.sample(desired.duration_s / count)
    if not model.rate_independent:
        times = np.interp(sample_positions(wanted, model.training), np.arange(len(times)), times)
        wanted = desired(times)
    memory, q_cmd = request.memory, request.q_start
    error = memory.joints(q_cmd) - q_cmd
    unbounded, correction, given_up = wanted.copy(), np.zeros_like(wanted), np.zeros_like(wanted)
    unbounded[0], correction[0] = q_cmd, q_cmd - wanted[0]
    for row, q in enumerate(wanted[1:], start=1):
        unbounded[row] = inverse(model, memory.state, q, q - error, SKETCH_RAD)
        q_cmd = np.clip(unbounded[row], lower, upper)
        if np.any(q_cmd != unbounded[row]):
            # The other joints can still be right: they take into account where this one stays.
            kept = np.where(q_cmd != unbounded[row], memory.joints(q_cmd), q)
            q_cmd = np.clip(inverse(model, memory.state, kept, q_cmd, SKETCH_RAD), lower, upper)
        joints, after = memory.step(q_cmd)
        if np.any(q_cmd != unbounded[row]):
            given_up[row] = memory.joints(unbounded[row]) - joints
        error, correction[row], memory = joints - q_cmd, q_cmd - q, after
    asked = times <= request.desired.duration_s
    excess = np.where(asked[:, None], np.maximum(lower - unbounded, unbounded - upper), -np.inf)
    farthest = np.take_along_axis(unbounded, excess.argmax(axis=0)[None], axis=0)[0]
    request, shares = replace(request, desired=desired), times / desired.duration_s
    return InitialCommands(request, lower, upper, shares, correction, given_up, farthest, q_cmd)


def _ranges(request: CommandRequest) -> tuple[Array, Array]:
    """Return the least and greatest commands (6,) that are allowed: also where the joints, or a start, lie outside."""
    v, asked = request.velocity_start, request.desired.sample(request.desired.duration_s / KNOTS[1])[1]
    stop = request.q_start + v * np.abs(v) / (2 * request.limits.acceleration) + v * KNOT_S[1]
    taken = np.vstack([asked, request.q_start, stop])
    return np.minimum(request.lower, taken.min(axis=0)), np.maximum(request.upper, taken.max(axis=0))


def knots_of(desired: Trajectory) -> Array:
    """Return the times (n + 1,) of the commands' knots: where the motion has its own, and evenly in between."""
    corners, duration = desired.times_s, desired.duration_s
    spacing = min(float(np.clip(duration / KNOTS[1], *KNOT_S)), duration / KNOTS[0])
    kept = [0.0]
    for corner in corners[1:-1].tolist():
        if min(corner - kept[-1], duration - corner) >= spacing / 2:
            kept.append(corner)
    kept.append(duration)
    parts = [
        np.linspace(start, end, int(np.ceil((end - start) / spacing - 1e-6)), endpoint=False)
        for start, end in pairwise(kept)
    ]
    return np.append(np.concatenate(parts), duration)
