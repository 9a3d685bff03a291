"""Commands that make the joints arrive where they should, by any cable model."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.calibration.models.base import CableModel, TrainingMotion, commands
from trocar.calibration.plant import WRIST
from trocar.errors import TrocarError

METHODS = ("auto", "exact", "algorithm1")

ITERATIONS = 5
ALPHA = 0.5
"""Algorithm 1 at the learning rate that the paper ran; a constant offset falls to (1 - alpha)^M = 3 %."""

TOLERANCE_RAD = 1e-5
"""The exact inverse stops here: a hundredth of the repeatability of the best joint."""
MAX_NEWTON_STEPS = 30
MAX_NEWTON_STEP_RAD = 0.3
"""In a dead zone a joint hardly follows its command and Newton's step explodes; a full backlash suffices."""
STALLED_RAD = 1e-3
ESCAPES_RAD = (0.1, -0.1, 0.2, -0.2, 0.4, -0.4)
"""Where Newton stalls in a dead zone it starts again this far along the direction that the joints ignore."""
DAMPING = 1e-4


@runtime_checkable
class Invertible(Protocol):
    """A cable model that also gives the wrist's Jacobian, which an exact inverse needs."""

    def linearize(self, state: Any, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joints (6,) after the command (6,) and d q_joint / d q_cmd of the wrist (3, 3)."""
        ...


def algorithm1(
    model: CableModel,
    state: Any,
    q_desired: NDArray[np.float64],
    iterations: int = ITERATIONS,
    alpha: float = ALPHA,
) -> NDArray[np.float64]:
    """Return the command (6,) by the paper's Algorithm 1: M times ``q_c += alpha (q_d - f(q_c; state))``."""
    q_cmd = q_desired
    for _ in range(iterations):
        q_cmd = q_cmd + alpha * (q_desired - model.step(state, q_cmd)[0])
    return q_cmd


def exact_inverse(
    model: Invertible, state: Any, q_desired: NDArray[np.float64], guess: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the command (6,) whose prediction is ``q_desired``, and that prediction.

    Damped Newton steps with backtracking; the model is smooth but for the kinks where an operator starts to
    move, and nearly flat in its dead zones, from where further starts escape. Where no command
    reaches the target exactly, the nearest one found is returned.
    """
    q_cmd, joints, jacobian = _newton(model, state, q_desired, guess)
    miss = float(np.abs(q_desired - joints)[WRIST].max())
    if miss > STALLED_RAD:
        ignored = np.linalg.svd(jacobian)[2][-1]
        for distance in ESCAPES_RAD:
            start = q_cmd.copy()
            start[WRIST] += distance * ignored
            other, other_joints, _ = _newton(model, state, q_desired, start)
            other_miss = float(np.abs(q_desired - other_joints)[WRIST].max())
            if other_miss < miss:
                q_cmd, joints, miss = other, other_joints, other_miss
            if miss < STALLED_RAD:
                break
    return q_cmd, joints


def _newton(
    model: Invertible, state: Any, q_desired: NDArray[np.float64], guess: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the command (6,) that damped Newton steps find from ``guess``, its prediction and Jacobian."""
    q_cmd = guess.copy()
    joints, jacobian = model.linearize(state, q_cmd)
    q_cmd[:3] += q_desired[:3] - joints[:3]
    joints, jacobian = model.linearize(state, q_cmd)
    for _ in range(MAX_NEWTON_STEPS):
        miss = q_desired[WRIST] - joints[WRIST]
        size = float(miss @ miss)
        if size < TOLERANCE_RAD**2:
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
    """Turns desired joints into commands along a path, carrying the model's memory from call to call.

    ``auto`` takes the exact inverse where the model has one, else Algorithm 1. Models with a window
    (``lstm``, ``ridge``) must see samples as dense as in training: :func:`resample` a path first.
    The play model does not depend on the sampling.

    Attributes:
        model: the cable model.
        method: ``'exact'`` or ``'algorithm1'``.
    """

    def __init__(
        self,
        model: CableModel,
        method: str = "auto",
        iterations: int = ITERATIONS,
        alpha: float = ALPHA,
    ):
        if method not in METHODS:
            raise TrocarError(f"compensation method {method!r} is unknown; choose one of {', '.join(METHODS)}")
        if iterations < 1 or not 0.0 < alpha <= 1.0:
            raise TrocarError(
                f"Algorithm 1 with {iterations} iterations and alpha {alpha} does nothing sensible; "
                "give 1 or more iterations and an alpha in (0, 1]"
            )
        self._inverse = model if isinstance(model, Invertible) and method != "algorithm1" else None
        if method == "exact" and self._inverse is None:
            raise TrocarError(f"model {model.name!r} has no exact inverse; use method 'algorithm1'")
        self.model = model
        self.method = "algorithm1" if self._inverse is None else "exact"
        self._iterations, self._alpha = iterations, alpha
        self._state: Any = None
        self._started = False
        self._error = np.zeros(6)

    def start(self, q_cmd: ArrayLike) -> None:
        """Forget the past: the arm has rested at this command (6,)."""
        q = commands(np.asarray(q_cmd, dtype=np.float64)[None])[0]
        self._state = self.model.start(q)
        self._error = self.model.step(self._state, q)[0] - q
        self._started = True

    def observe(self, q_cmd: ArrayLike) -> None:
        """Take note of commands (n, 6) that were sent without compensation: they belong to the memory."""
        for q in commands(q_cmd):
            if not self._started:
                self.start(q)
            self._take(q)

    def path(self, q_desired: ArrayLike) -> NDArray[np.float64]:
        """Return the commands (n, 6) that bring the joints along ``q_desired`` (n, 6), one after the other.

        The first call starts at rest at its first row, unless :meth:`start` or :meth:`observe` came before.
        """
        desired = commands(q_desired)
        return np.array([self._point(q) for q in desired]).reshape(-1, 6)

    def _point(self, q_desired: NDArray[np.float64]) -> NDArray[np.float64]:
        if not self._started:
            self.start(q_desired)
        if self._inverse is not None:
            q_cmd, _ = exact_inverse(self._inverse, self._state, q_desired, q_desired - self._error)
        else:
            q_cmd = algorithm1(self.model, self._state, q_desired, self._iterations, self._alpha)
        self._take(q_cmd)
        return q_cmd

    def _take(self, q_cmd: NDArray[np.float64]) -> None:
        joints, self._state = self.model.step(self._state, q_cmd)
        self._error = joints - q_cmd


def sample_positions(q: ArrayLike, training: TrainingMotion) -> NDArray[np.float64]:
    """Return where to sample a path (n, 6), as fractional row numbers from 0 to n - 1.

    No joint moves further between two samples than in the training motion on average; the given rows stay
    samples, so that corners are kept. It carries times along: ``np.interp(positions, range(n), times)``.
    """
    path = commands(q)
    interval = np.where(training.interval > 0, training.interval, np.inf)
    pieces = np.ceil(np.max(np.abs(np.diff(path, axis=0)) / interval, axis=1) - 1e-9)
    pieces = np.maximum(pieces, 1).astype(int)
    parts = [i + np.arange(count) / count for i, count in enumerate(pieces)]
    return np.concatenate([*parts, [len(path) - 1.0]])


def resample(q: ArrayLike, training: TrainingMotion) -> NDArray[np.float64]:
    """Return a path (n, 6) resampled to the training motion's interval in joint space (paper, IV-A)."""
    path = commands(q)
    at, rows = sample_positions(path, training), np.arange(len(path))
    return np.column_stack([np.interp(at, rows, column) for column in path.T])
