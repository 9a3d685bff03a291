"""Compensation of cable errors: commands that bring the joints to desired positions, by any cable model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from trocar.calibration.models.base import CableModel, Invertible, TrainingMotion, commands
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import WRIST
from trocar.geometry.arrays import Array
from trocar.trajectory import Trajectory

REPLAY_S = 0.004
"""Interval at which sent commands are replayed. A wrist's sharpest reversal (25 rad/s^2) hides 5e-5 rad within it."""


@dataclass(frozen=True, eq=False)
class HysteresisState:
    """What a cable model knows about one arm's cables after the commands so far.

    A rate-independent model takes every command into its state. A model with a window takes a sample only when a wrist
    joint has moved by its mean step in the training motion. So the window spans as much of the wrist's motion as in
    training, however often an arm is stopped, slowed down or replanned. The outer joints do not count: their cables
    have no memory, and a lift with a still wrist would push the wrist's earlier motion out of the window.

    Attributes:
        model: the cable model.
        state: state of the model after its last sample.
        q_cmd: (6,) command of the last sample, rad and m.
    """

    model: CableModel
    state: Any
    q_cmd: Array

    @classmethod
    def at_rest(cls, model: CableModel, q_cmd: ArrayLike) -> Self:
        """Return the memory of an arm that is at rest at this command (6,) and whose past is unknown."""
        (q,) = commands(np.asarray(q_cmd, dtype=np.float64)[None])
        return cls(model, model.start(q), q)

    def joints(self, q_cmd: Array) -> Array:
        """Return the joints (6,) if this command (6,) comes next."""
        return self.model.step(self.state, q_cmd)[0]

    def step(self, q_cmd: Array) -> tuple[Array, HysteresisState]:
        """Return the joints (6,) after this command (6,), and the new memory."""
        joints, state = self.model.step(self.state, q_cmd)
        return joints, replace(self, state=state, q_cmd=q_cmd) if self._is_sample(q_cmd) else self

    def after(self, sent: Trajectory, until_s: float) -> HysteresisState:
        """Return the memory after the commands up to a time on the trajectory's clock."""
        duration = min(max(until_s - sent.times_s[0], 0.0), sent.duration_s)
        path = sent(sent.times_s[0] + np.linspace(0.0, duration, 1 + int(np.ceil(duration / REPLAY_S))))
        if isinstance(self.model, PlayModel):
            return replace(self, state=self.model.remember(self.state, path), q_cmd=path[-1])
        memory = self
        for q in path:
            if memory._is_sample(q):
                _, memory = memory.step(q)
        return memory

    def along(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) after each of the commands (n, 6), one after the other."""
        memory, joints = self, np.empty_like(q_cmd)
        for row, q in enumerate(q_cmd):
            joints[row], memory = memory.step(q)
        return joints

    def _is_sample(self, q_cmd: Array) -> bool:
        if self.model.rate_independent:
            return True
        interval = self.model.training.interval[WRIST]
        return bool(np.any(np.abs(q_cmd - self.q_cmd)[WRIST] >= np.where(interval > 0, interval, np.inf)))


ITERATIONS = 5
ALPHA = 0.5
"""Iterations M and learning rate of Algorithm 1, as in the paper; a constant offset falls to (1 - alpha)^M = 3 %."""

TOLERANCE_RAD = 1e-5  # the exact inverse stops at this residual: a hundredth of the repeatability of the best joint
MAX_NEWTON_STEPS = 30
MAX_NEWTON_STEP_RAD = 0.3
"""Longest Newton step: a full backlash. In a dead zone a joint hardly follows its command, and a step would explode."""
STALLED_RAD = 1e-3
ESCAPES_RAD = (0.1, -0.1, 0.2, -0.2, 0.4, -0.4)
"""Where Newton's method stalls in a dead zone, it restarts this far away, in the direction that the joints ignore."""
DAMPING = 1e-4


def algorithm1(model: CableModel, state: Any, q_desired: Array) -> Array:
    """Return the command (6,) by the paper's Algorithm 1: M times ``q_c += alpha (q_d - f(q_c; state))``."""
    q_cmd = q_desired
    for _ in range(ITERATIONS):
        q_cmd = q_cmd + ALPHA * (q_desired - model.step(state, q_cmd)[0])
    return q_cmd


def inverse(
    model: CableModel,
    state: Any,
    q_desired: Array,
    guess: Array,
    tolerance_rad: float = TOLERANCE_RAD,
    stalled_rad: float = STALLED_RAD,
) -> Array:
    """Return the command (6,) that brings the joints to ``q_desired`` (6,).

    An ``Invertible`` model is solved exactly, by damped Newton steps with backtracking from ``guess``. It is smooth
    except for kinks where a play operator starts to move, and nearly flat in dead zones, which restarts escape. If no
    command reaches the target exactly, the one with the smallest error found is returned. Other models take
    :func:`algorithm1`.
    """
    if not isinstance(model, Invertible):
        return algorithm1(model, state, q_desired)
    q_cmd, joints, jacobian = _newton(model, state, q_desired, guess, tolerance_rad)
    miss = float(np.abs(q_desired - joints)[WRIST].max())
    if miss > stalled_rad:
        ignored = np.linalg.svd(jacobian)[2][-1]
        for distance in ESCAPES_RAD:
            start = q_cmd.copy()
            start[WRIST] += distance * ignored
            other, other_joints, _ = _newton(model, state, q_desired, start, tolerance_rad)
            other_miss = float(np.abs(q_desired - other_joints)[WRIST].max())
            if other_miss < miss:
                q_cmd, miss = other, other_miss
            if miss < stalled_rad:
                break
    return q_cmd


def _newton(
    model: Invertible, state: Any, q_desired: Array, guess: Array, tolerance_rad: float
) -> tuple[Array, Array, Array]:
    """Return the command (6,) that damped Newton steps reach from ``guess``, its prediction and its Jacobian."""
    q_cmd = guess.copy()
    joints, jacobian = model.linearize(state, q_cmd)
    q_cmd[:3] += q_desired[:3] - joints[:3]
    joints, jacobian = model.linearize(state, q_cmd)
    for _ in range(MAX_NEWTON_STEPS):
        miss = q_desired[WRIST] - joints[WRIST]
        size = float(miss @ miss)
        if size < tolerance_rad**2:
            break
        step = np.linalg.solve(jacobian.T @ jacobian + DAMPING * np.eye(3), jacobian.T @ miss)
        step *= min(1.0, MAX_NEWTON_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
        for share in (1.0, 0.5, 0.25, 0.1, 0.03):
            trial = q_cmd.copy()
            trial[:3] += q_desired[:3] - joints[:3]
            trial[WRIST] += share * step
            trial_joints, trial_jacobian = model.linearize(state, trial)
            left = q_desired[WRIST] - trial_joints[WRIST]
            if left @ left < size:
                break
        else:
            break
        q_cmd, joints, jacobian = trial, trial_joints, trial_jacobian
    return q_cmd, joints, jacobian


class Compensator:
    """Turns desired joints into commands along a path, and keeps the model's memory from call to call.

    The commands are exact if the model is ``Invertible``, else those of Algorithm 1. Models with a window (``lstm``,
    ``ridge``) need samples as dense as in training: :func:`resample` the path first. The play model does not depend on
    the sampling.

    Example:
        >>> import numpy as np
        >>> from trocar.arms import PSM_CLASSIC
        >>> from trocar.calibration.compensation import Compensator
        >>> from trocar.calibration.excitation import random_smooth_path
        >>> from trocar.calibration.models import OffsetModel
        >>> from trocar.calibration.plant import PSM1_GREY
        >>> from trocar.calibration.recording import Recording
        >>> q_cmd = random_smooth_path(PSM_CLASSIC, np.random.default_rng(0), 200)
        >>> measured = PSM1_GREY.run(q_cmd)
        >>> recording = Recording(q_cmd, measured, np.ones(200, dtype=bool), np.arange(200.0))
        >>> model = OffsetModel.fit(recording, np.random.default_rng(0))
        >>> compensator = Compensator(model)
        >>> compensator.start(q_cmd[0])
        >>> compensator.path(q_cmd[:5]).shape
        (5, 6)
    """

    def __init__(self, model: CableModel):
        self.model = model
        self._state: Any = None
        self._error: Array | None = None  # joints minus command, of the last command

    def start(self, q_cmd: ArrayLike) -> None:
        """Reset the memory: the arm has been at rest at this command (6,)."""
        (q,) = commands(np.asarray(q_cmd, dtype=np.float64)[None])
        self._state = self.model.start(q)
        self._error = self.model.step(self._state, q)[0] - q

    def path(self, q_desired: ArrayLike) -> Array:
        """Return the commands (n, 6) that move the joints along ``q_desired`` (n, 6), row by row.

        Unless :meth:`start` was called before, the arm is taken to be at rest at the first row.
        """
        desired = commands(q_desired)
        if self._error is None and len(desired):
            self.start(desired[0])
        q_cmd = np.empty_like(desired)
        for row, q in enumerate(desired):
            q_cmd[row] = inverse(self.model, self._state, q, q - self._error)
            joints, self._state = self.model.step(self._state, q_cmd[row])
            self._error = joints - q_cmd[row]
        return q_cmd


def sample_positions(q: ArrayLike, training: TrainingMotion) -> Array:
    """Return the positions at which to sample a path (n, 6), as fractional row numbers from 0 to n - 1.

    Between two samples no joint moves farther than in the training motion on average. The given rows stay samples, so
    that corners are kept. Times are resampled likewise: ``np.interp(positions, range(n), times)``.
    """
    path = commands(q)
    interval = np.where(training.interval > 0, training.interval, np.inf)
    pieces = np.ceil(np.max(np.abs(np.diff(path, axis=0)) / interval, axis=1) - 1e-9)
    pieces = np.maximum(pieces, 1).astype(int)
    parts = [i + np.arange(count) / count for i, count in enumerate(pieces)]
    return np.concatenate([*parts, [len(path) - 1.0]])


def resample(q: ArrayLike, training: TrainingMotion) -> Array:
    """Return a path (n, 6) resampled to the training motion's interval in joint space (paper, IV-A)."""
    path = commands(q)
    at, rows = sample_positions(path, training), np.arange(len(path))
    return np.column_stack([np.interp(at, rows, column) for column in path.T])
