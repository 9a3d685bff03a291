"""The path of commands that brings the joints nearest to where they should be, by successive quadratic programs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from trocar.arms import MotionLimits
from trocar.calibration.compensation import HysteresisState, inverse, sample_positions
from trocar.calibration.limited_paths import HEADROOM, LimitedPaths, QuadraticSpline
from trocar.calibration.models.play import PlayModel, PlayResponse
from trocar.calibration.plant import WRIST
from trocar.errors import InvalidInput
from trocar.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class CommandRequest:
    """What one arm's joints should do, and where its commands are now.

    Attributes:
        memory: of the cables, up to the commands that were sent last.
        desired: of the true joints (rad, m), from its first knot on. It may start and end in motion; after an end in
            motion it is braked to rest.
        q_start: (6,) command that is being sent now. It may differ from what the model expects there.
        velocity_start: (6,) its velocity.
        limits: of the commands' velocity and acceleration.
        lower: (6,) least commands. Where the desired joints themselves lie below, commands may as well.
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
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (6,) or not np.all(np.isfinite(value)):
                raise InvalidInput(f"{name} of a request", f"is {value.tolist()}", "give six finite numbers")
            object.__setattr__(self, name, value)
        over = np.abs(self.velocity_start) / self.limits.velocity
        if over.max() > 1 + 1e-6:
            raise InvalidInput(
                f"joint {np.argmax(over) + 1}",
                f"has commands that already run at {over.max():.2f} times their limit of velocity",
                "let them slow down before a new motion",
            )


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


Array = NDArray[np.float64]

LEVER = np.array([10.0, 10.0, 67.0, 0.7, 1.0, 1.0])
"""How far an error of q1 to q6 moves the tip (.15 m, .15 m, 1, .01 m, .015 m, .015 m) in units of the wrist's 15 mm."""

EASE = np.array([1e-4, 1e-4, 1e-5, 2.5e-3, 2.5e-3, 2.5e-3])
"""Error (rad, m) of a joint that is tolerated if it saves full acceleration: 10 to 40 um at the tip."""

NEAR = 0.03
"""Weight of moving the commands, as a share of that of an equally large joint error. It damps steps in dead zones,
where the joints hardly follow."""

TAUT = 0.15
"""Share of a taut cable's response that is assumed within the slack too. There the response of the coupled joints is
nearly singular, or even reversed; this share pushes the commands in the direction that crosses the slack."""

STEPS = 5
SETTLED = 0.7
"""Refinement ends after a step that leaves more than this share of the cost, once the end is met."""
SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of a step, tried in turn until the cost falls."""

MET = 3e-5
"""The end counts as reached within this distance, in rad of the wrist."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A path of commands and the joint motion that results.

    Attributes:
        x: (m, 6) its free control points.
        q_cmd: (n + 1, 6) commands at the knots.
        error: (n + 1, 6) wanted joints minus the joints reached there.
        cost: weighted sum of the errors' squares.
        response: of a play model.
        turns_s: (n, 3) when each input of a play model reverses, counted from the start of each interval.
    """

    x: Array
    q_cmd: Array
    error: Array
    cost: float
    response: PlayResponse | None
    turns_s: Array

    @property
    def end_error(self) -> float:
        """Return how far from their goal the joints end, in rad of the wrist."""
        return float(np.max(np.abs(self.error[-1]) * LEVER))


@dataclass(frozen=True, eq=False)
class CommandFit:
    """Finds the best commands among the paths within the limits.

    Attributes:
        paths: those paths.
        memory: of the cables at the start.
        wanted: (n + 1, 6) joints at the knots.
    """

    paths: LimitedPaths
    memory: HysteresisState
    wanted: Array

    def nearest(self, q_cmd: Array) -> Array | None:
        """Return the path (m, 6) nearest to commands (n + 1, 6) at the knots; None if the limits allow none."""
        gradient = self.paths.pull(self.paths.resting - q_cmd) * LEVER**2 + self.paths.push * self._ease
        return self.paths.solve(self.paths.hessian(LEVER**2, self._ease), gradient)

    def predict(self, x: Array) -> Fitted:
        """Return the path with the joints that the model expects."""
        spline, model, points = self.paths.spline, self.memory.model, self.paths.points(x)
        q_cmd = spline.at(spline.position, spline.intervals, points)
        response, turns_s = None, np.zeros((len(spline.steps_s), 3))
        if isinstance(model, PlayModel):
            within, inputs = spline.intervals[:-1], model.inputs(points)
            speed, push = (spline.at(w, within, inputs) for w in (spline.velocity[:-1], spline.acceleration))
            turns_s = -speed / np.where(push == 0.0, np.inf, push)
            turns_s = np.clip(turns_s, 0.0, spline.steps_s[:, None])
            turns = model.inputs(q_cmd)[:-1] + speed * turns_s + push * turns_s**2 / 2
            response = model.respond(self.memory.state, q_cmd, turns)
        error = self.wanted - (self.memory.along(q_cmd) if response is None else response.joints)
        cost = float(np.sum(self.paths.weights_s[:, None] * (LEVER * error) ** 2))
        return Fitted(x, q_cmd, error, cost, response, turns_s)

    def refine(self, fitted: Fitted) -> Fitted:
        """Return a path that brings the joints nearer to where they should be, according to the play model."""
        for _ in range(STEPS):
            better = self._step(fitted)
            if better is None:
                break
            settled = better.cost > SETTLED * fitted.cost and better.end_error < MET
            fitted = better
            if settled:
                break
        return fitted

    def _step(self, fitted: Fitted) -> Fitted | None:
        """Return the path after one Gauss-Newton step, or None if no part of the step helps.

        The wrist joints depend on all commands so far, according to the model; the outer joints are assumed to follow
        theirs.
        """
        slopes = self._slopes(fitted)
        weighted = slopes.T.tocsr()
        weighted.data *= np.repeat(self.paths.weights_s, 3)[weighted.indices]
        hessian = self._damping + weighted @ slopes
        gradient = -self.paths.pull(fitted.error) * LEVER**2
        gradient[:, WRIST] = 0.0
        gradient -= (weighted @ fitted.error[:, WRIST].ravel()).reshape(6, -1).T
        gradient -= (hessian @ fitted.x.T.ravel()).reshape(6, -1).T
        gradient += self.paths.push * self._ease
        x = self.paths.solve(hessian + self._easing, gradient)
        if x is None:
            return None
        trials = (self.predict(fitted.x + share * (x - fitted.x)) for share in SHARES)
        return next((trial for trial in trials if trial.cost < fitted.cost), None)

    @cached_property
    def _ease(self) -> Array:
        """Return the weights (6,) of the joints' accelerations."""
        return (LEVER * EASE / self.paths.limits.acceleration) ** 2

    @cached_property
    def _easing(self) -> sparse.csc_matrix:
        return self.paths.hessian(np.zeros(6), self._ease)

    @cached_property
    def _damping(self) -> sparse.csc_matrix:
        """Return the Hessian of the outer joints, which follow their commands, and of the wrist's damping."""
        return self.paths.hessian(np.concatenate([LEVER[:3] ** 2, np.full(3, NEAR**2)]), np.zeros(6))

    def _slopes(self, fitted: Fitted) -> sparse.csr_matrix:
        """Return the derivatives (3 n + 3, 6 m) of the wrist's joints at the knots by the free control points.

        A joint depends on the command at its own time and, through every operator that is now in its slack, on the
        command that drove this operator last: at a knot, or where its input reversed within an interval.
        """
        spline, model, response = self.paths.spline, self.memory.model, fitted.response
        assert isinstance(model, PlayModel) and response is not None
        knots, free, joints = len(spline.times_s), len(fitted.x), np.arange(3)
        weights, columns = self.paths.columns(spline.position, spline.intervals)
        local = response.by_command + TAUT * (response.taut - response.by_command)
        local[-1] = response.by_command[-1]
        # Axes of an entry: knot (and operator), joint, command, control point.
        entries = [local[:, :, :, None] * weights[:, None, None, :]]
        rows = [(3 * np.arange(knots)[:, None] + joints)[:, :, None, None]]
        places = [(free * (3 + joints)[:, None] + columns[:, None, None, :])]
        for j in range(3):
            turned = self.paths.columns(spline.position_after(fitted.turns_s[:, j]), spline.intervals[:-1])
            path_weights, path_columns = _interleaved(weights, turned[0]), _interleaved(columns, turned[1])
            moved = response.moved[:, j]
            knot, operator = np.nonzero((moved > 0) & (moved < 2 * np.arange(knots)[:, None]))
            driver = moved[knot, operator]
            mixed = np.flatnonzero(model.mix[j])
            by_command = response.by_operator[knot, :, j, operator][:, :, None] * model.mix[j, mixed]
            entries.append(by_command[..., None] * path_weights[driver][:, None, None, :])
            rows.append((3 * knot[:, None] + joints)[:, :, None, None])
            places.append(free * (3 + mixed)[:, None] + path_columns[driver][:, None, None, :])
        values = np.concatenate([entry.ravel() for entry in entries])
        indices = [
            np.concatenate([np.broadcast_to(i, e.shape).ravel() for i, e in zip(index, entries, strict=True)])
            for index in (rows, places)
        ]
        return sparse.csr_matrix((values, tuple(indices)), shape=(3 * knots, 6 * free))


def _interleaved(at_knots: NDArray, between: NDArray) -> NDArray:
    """Return rows (2 n + 1, ...) of the knots (n + 1, ...) with those of the intervals (n, ...) in between."""
    rows = np.empty((len(at_knots) + len(between), *at_knots.shape[1:]), at_knots.dtype)
    rows[::2], rows[1::2] = at_knots, between
    return rows
