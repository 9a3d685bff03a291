"""The path of commands that brings the joints nearest to where they should be, by successive quadratic programs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from trocar.calibration.compensation import HysteresisState
from trocar.calibration.limited_paths import LimitedPaths
from trocar.calibration.models.play import PlayModel, PlayResponse
from trocar.calibration.plant import WRIST
from trocar.geometry.arrays import Array

LEVER = np.array([10.0, 10.0, 67.0, 0.7, 1.0, 1.0])
"""Weights of errors of q1 to q6: lever arms to the tip (.15 m, .15 m, 1, .01 m, .015 m, .015 m) over the wrist's."""

EASE = np.array([1e-4, 1e-4, 1e-5, 2.5e-3, 2.5e-3, 2.5e-3])
"""Joint errors (rad, m) that cost as much as full acceleration does: 10 to 40 um at the tip."""

NEAR = 0.03
"""Weight of moving the commands, as a share of that of an equally large joint error. It damps steps in dead zones,
where the joints hardly follow."""

TAUT = 0.15
"""Share of a taut cable's response that is assumed within the slack too. There the response of the coupled joints is
nearly singular, or even reversed; this share pushes the commands in the direction that crosses the slack."""

STEPS = 5
SETTLED = 0.7  # refinement ends after a step that leaves more than this share of the cost, once the end is met
SHARES = (1.0, 0.5, 0.25, 0.1)  # shares of a step, tried in turn until the cost falls
MET = 3e-5  # the end counts as reached within this distance, in rad of the wrist


@dataclass(frozen=True, eq=False)
class Fitted:
    """A path of commands and the joint motion that results."""

    x: Array  # (m, 6) its free control points
    q_cmd: Array  # (n + 1, 6) commands at the knots
    error: Array  # (n + 1, 6) wanted joints minus the joints reached there
    cost: float  # weighted sum of the errors' squares
    response: PlayResponse | None  # of a play model
    turns_s: Array  # (n, 3) when each input of a play model reverses, counted from the start of each interval

    @property
    def end_error(self) -> float:
        """Return how far from their goal the joints end, in rad of the wrist."""
        return float(np.max(np.abs(self.error[-1]) * LEVER))


@dataclass(frozen=True, eq=False)
class CommandFit:
    """The search for the best commands among the paths within the limits."""

    paths: LimitedPaths
    memory: HysteresisState  # of the cables at the start
    wanted: Array  # (n + 1, 6) joints at the knots

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
