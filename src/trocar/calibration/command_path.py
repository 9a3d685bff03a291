"""Commands that move the joints along a motion and keep the limits of velocity and acceleration themselves.

The plan shows where a cable's slack has to be crossed. So all commands of a motion are found at once: among the paths
that keep the limits, the one that brings the joints nearest to where they should be. It starts to cross a slack before
the joint has to reverse, and ends where the model puts the joints exactly at their goal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trocar.arms import MotionLimits
from trocar.calibration.command_fit import LEVER, MET, CommandFit, Fitted
from trocar.calibration.compensation import HysteresisState, inverse, sample_positions
from trocar.calibration.limited_paths import HEADROOM, LimitedPaths, QuadraticSpline
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array, finite
from trocar.motion.moves import rest_to_rest
from trocar.trajectory import Trajectory

KNOT_S = (0.010, 0.025)
"""Least and greatest spacing of knots: one control period, and a tenth of the time needed to cross the widest slack."""
KNOTS = (12, 48)
"""Least number of intervals, and the number at which the spacing grows to its greatest before more are added."""
SKETCH_S = 0.060  # initial spacing of the points at which the model is inverted, one after the other
SKETCHED = 4  # minimum number of these points
SKETCH_RAD = 1e-3  # accuracy of the inversion; refinement does the rest
RESTING_S = 1e-4  # a joint that could be stopped in less than this counts as resting
ENDS_S = 0.2
ENDS_WEIGHT = 10.0
"""Errors weigh up to ``ENDS_WEIGHT`` times more near the start and the end of a motion, for about ``ENDS_S``, than in
its middle, because the jaws are near objects there."""
END_WEIGHT_S = 1000.0  # weight of an error at the very end: that of the same error lasting this long
CORRECTIONS = 2  # corrections of the last command, tried where refinement stalls short of the end
TOO_FAST = 1.1
"""A motion that is faster than the limits by less than this factor is not slowed down. Its commands fall behind and
catch up before its end. The lag reaches .04 rad and 3.5 mm in the outer joints and 8 mm at the tip (at full
acceleration, over .3 rad and 20 mm, there and back, 1.1 times too fast)."""
NEARLY_MET = 1e-3  # a motion that ends further from its goal than this (rad of the wrist) usually lacks time
STRETCHES = (1.0, 1.05, 1.15, 1.3)  # factors tried in turn on the least time for the path to the last command
LAST_STEP_S = 0.3
"""A last step from rest to rest is made even for a small error if it takes no longer than this: in a dead zone, only
crossing the slack removes the error. If the motion ends further off than ``NEARLY_MET``, the step may take longer."""


@dataclass(frozen=True, eq=False)
class CommandRequest:
    """What one arm's joints should do, and where its commands are now.

    Attributes:
        memory: state of the cables after the last sent command.
        desired: motion of the true joints (rad, m), from its first knot on. It may start and end in motion; after an
            end in motion it is braked to rest.
        q_start: (6,) command that is being sent now. It may differ from what the model expects there.
        velocity_start: (6,) velocity of this command.
        limits: the commands' velocity and acceleration limits.
        lower: (6,) least commands. Commands may go lower where the desired joints do.
        upper: (6,) greatest commands, likewise.
    """

    memory: HysteresisState
    desired: Trajectory
    q_start: Array
    velocity_start: Array
    limits: MotionLimits
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        for name in ("q_start", "velocity_start", "lower", "upper"):
            object.__setattr__(self, name, finite(f"{name} of a request", getattr(self, name), 6))
        over = np.abs(self.velocity_start) / self.limits.velocity
        if over.max() > 1 + 1e-6:
            problem = f"has commands that already run at {over.max():.2f} times their limit of velocity"
            raise InvalidInput(f"joint {np.argmax(over) + 1}", problem, "let them slow down before a new motion")


@dataclass(frozen=True, eq=False)
class CommandPath:
    """Commands that carry one arm's joints along a motion within the limits.

    Attributes:
        commands: (t) -> (6,), from time 0; starts as requested and ends at rest.
        desired: the requested joint motion, on the same clock.
        missing: (6,) how far from ``desired`` the model expects the joints at the end, rad and m.
        lacking: (6,) by how much the commands would have to leave their ranges to compensate fully, rad and m.
        farthest: (6,) each joint's command nearest to, or farthest beyond, an end of its range, if ranges were ignored.
        stretch: factor by which the motion was slowed down; 1 if it was not.
        memory: state of the cables at the start.
    """

    commands: Trajectory
    desired: Trajectory
    missing: Array
    lacking: Array
    farthest: Array
    stretch: float
    memory: HysteresisState

    def memory_at(self, t_s: float) -> HysteresisState:
        """Return the memory of the cables after the commands up to a time, for a stop or a motion that takes over."""
        return self.memory.after(self.commands, t_s)


@dataclass(frozen=True, eq=False)
class InitialCommands:
    """A request with a rough version of its commands, without limits."""

    request: CommandRequest  # whose desired joints end at rest
    lower: Array  # (6,) least commands that are allowed, room to brake included
    upper: Array  # (6,) greatest
    shares: Array  # (k,) points, as shares of the motion's time
    correction: Array  # (k, 6) commands minus desired joints
    given_up: Array  # (k, 6) part of the desired joints that is given up because commands may not leave their ranges
    farthest: Array  # (6,) each joint's farthest command towards or beyond the ends of its range, had it none
    end: Array  # (6,) last command

    def at(self, shares: Array, rows: Array) -> Array:
        """Return rows (k, 6) of this sketch at other shares (n,) of the time: (n, 6)."""
        return np.column_stack([np.interp(shares, self.shares, column) for column in rows.T])

    def min_stretch(self) -> float:
        """Return the least factor by which to slow down, for the motion and for the path to the last command."""
        desired, limits = self.request.desired, self.request.limits
        times = np.linspace(0.0, desired.duration_s, int(np.ceil(desired.duration_s / KNOT_S[0])) + 1)
        speed, push = (np.abs(desired(times, order)) for order in (1, 2))
        motion = max(float(np.max(speed / limits.velocity)), float(np.sqrt(np.max(push / limits.acceleration))))
        return max(motion if motion > TOO_FAST else 1.0, self.way_stretch())

    def way_stretch(self) -> float:
        """Return the least factor with which the path to the last command alone keeps the limits."""
        request, knots = self.request, knots_of(self.request.desired)
        limits = request.limits.scaled(1.0 - 2.0 * HEADROOM)
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
            # Solve again, so that the other joints are right although the clipped ones stay behind.
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
    """Return the least and greatest commands (6,), widened to hold the desired joints, the start and its stop."""
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


def command_paths(requests: Mapping[str, CommandRequest]) -> dict[str, CommandPath]:
    """Return the commands of one or more arms that move together.

    The arms share one clock: if one needs more time, all are slowed down by the same factor. Only a last step from rest
    to rest, which is rarely needed, is made by one arm alone.

    Raises:
        TrocarError: no commands within the limits were found.
    """
    if not requests:
        return {}
    sketches = {arm: sketched(request) for arm, request in requests.items()}
    least = max(sketch.min_stretch() for sketch in sketches.values())
    fits: dict[str, _Fit] = {}
    for more in STRETCHES:
        tried = {arm: _fitted(sketch, least * more) for arm, sketch in sketches.items()}
        fits = {arm: fit for arm, fit in tried.items() if fit is not None}
        if len(fits) == len(tried) and all(fit.short < NEARLY_MET for fit in fits.values()):
            break
    lost = [repr(arm) for arm in requests if arm not in fits]
    if lost:
        problem = f"of arm {', '.join(lost)} within the limits were found"
        raise InvalidInput("no commands", problem, "let it come to rest before the motion")
    return {arm: _finished(fit) for arm, fit in fits.items()}


@dataclass(frozen=True, eq=False)
class _Fit:
    """The commands that were found for a sketch."""

    sketch: InitialCommands
    stretch: float  # factor by which it is slowed down
    fit: CommandFit  # the set of possible commands
    best: Fitted
    short: float  # how far from their goal they end, in rad of the wrist; measured in joints if the model predicts them


def _fitted(sketch: InitialCommands, stretch: float) -> _Fit | None:
    """Return commands for the motion slowed down by this factor; None if the limits allow none."""
    request, desired = sketch.request, sketch.request.desired.stretched(stretch)
    spline = QuadraticSpline(knots_of(desired))
    shares, asked = spline.times_s / spline.times_s[-1], desired(spline.times_s)
    start = request.q_start, request.velocity_start
    paths = LimitedPaths(spline, *start, request.limits, sketch.lower, sketch.upper, _weights(spline))
    fit = CommandFit(paths, request.memory, asked - sketch.at(shares, sketch.given_up))
    x = fit.nearest(asked + sketch.at(shares, sketch.correction))
    if x is None:
        return None
    roughly = fit.predict(x)
    if roughly.response is None:
        # Refinement would not help other models: their own errors exceed what Algorithm 1 leaves.
        return _Fit(sketch, stretch, fit, roughly, float(np.max(LEVER * np.abs(x[-1] - sketch.end))))
    best = _ended(sketch, fit, fit.refine(roughly))
    return _Fit(sketch, stretch, fit, best, best.end_error)


def _ended(sketch: InitialCommands, fit: CommandFit, fitted: Fitted) -> Fitted:
    """Return a path with a better end if refinement has stalled before the goal, at the kinks of a dead zone."""
    best = fitted
    for _ in range(CORRECTIONS):
        if best.end_error < MET:
            break
        target = fitted.q_cmd.copy()
        target[-1] = _last_command(sketch, fit, fitted, float(fit.paths.spline.times_s[-2]))
        x = fit.nearest(target)
        if x is None:
            break
        fitted = fit.predict(x)
        best = min(best, fitted, key=lambda one: one.cost)
    return best


def _weights(spline: QuadraticSpline) -> Array:
    """Return the weights (n + 1,) of errors at the knots, in s."""
    t = spline.times_s
    span = np.diff(t, prepend=t[0], append=t[-1])
    near = np.exp(-((t / ENDS_S) ** 2)) + np.exp(-(((t[-1] - t) / ENDS_S) ** 2))
    weights = (span[:-1] + span[1:]) / 2 * (1.0 + ENDS_WEIGHT * near)
    weights[-1] = END_WEIGHT_S
    return weights


def _last_command(sketch: InitialCommands, fit: CommandFit, fitted: Fitted, since_s: float) -> Array:
    """Return the command (6,) that puts the joints at their goal, if the path went straight there from a time on."""
    if fitted.response is None:
        return sketch.end
    sent = fit.paths.spline.trajectory(fit.paths.points(fitted.x))
    memory = sketch.request.memory.after(sent, since_s)
    q_cmd = inverse(memory.model, memory.state, fit.wanted[-1], fitted.q_cmd[-1], stalled_rad=MET)
    return np.clip(q_cmd, sketch.lower, sketch.upper)


def _finished(found: _Fit) -> CommandPath:
    """Return the commands, with a last step from rest to rest if they would miss their goal."""
    sketch, fit, best = found.sketch, found.fit, found.best
    request, times = sketch.request, fit.paths.spline.times_s
    commands = fit.paths.spline.trajectory(fit.paths.points(best.x))
    desired = request.desired.stretched(found.stretch)
    goal = desired(times)[-1]
    step = _last_step(found, commands)
    if step is not None:
        commands = commands.then(step)
        desired = desired.then(Trajectory(np.array([0.0, step.duration_s]), goal[None, None]))
    end_s = commands.duration_s
    missing = goal - request.memory.after(commands, end_s).joints(commands(end_s))
    return CommandPath(
        commands=commands,
        desired=desired,
        missing=np.abs(missing),
        lacking=np.maximum(0.0, np.maximum(sketch.lower - sketch.farthest, sketch.farthest - sketch.upper)),
        farthest=sketch.farthest,
        stretch=found.stretch,
        memory=request.memory,
    )


def _last_step(found: _Fit, commands: Trajectory) -> Trajectory | None:
    """Return the step from where these commands end to where the joints reach their goal; None if it is negligible."""
    if found.short < MET:
        return None
    sketch, fit, best = found.sketch, found.fit, found.best
    q_cmd = _last_command(sketch, fit, best, commands.duration_s)
    limits = sketch.request.limits.scaled(1.0 - HEADROOM)
    step = rest_to_rest(best.q_cmd[-1], q_cmd, limits)
    if best.response is not None:
        memory = sketch.request.memory.after(commands, commands.duration_s)
        if np.max(LEVER * np.abs(fit.wanted[-1] - memory.joints(q_cmd))) >= found.short:
            return None
    return step if step.duration_s <= LAST_STEP_S or found.short > NEARLY_MET else None
