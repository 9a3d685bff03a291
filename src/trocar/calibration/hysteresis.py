"""What a cable model remembers of the commands that were really sent, carried from motion to motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.calibration.models.base import CableModel, commands
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import WRIST
from trocar.trajectory import Trajectory

REPLAY_S = 0.004
"""Interval at which sent commands are replayed: the sharpest reversal of a wrist (25 rad/s^2) hides 5e-5 rad within
it."""


@dataclass(frozen=True, eq=False)
class HysteresisState:
    """One arm's cables as a model knows them after the commands so far.

    A rate-independent model takes every command into its state. A model with a window takes a sample only where a
    joint of the wrist has gone on by its step in the training motion: however often an arm is stopped, slowed down or
    replanned, the window spans as much of the wrist's motion as in training. The outer joints do not count: their
    cables have no memory, and a lift with a still wrist would push the wrist's earlier motion out of the window.

    Attributes:
        model: the cables.
        state: the model's, after its last sample.
        q_cmd: (6,) the command of that sample, rad and m.
    """

    model: CableModel
    state: Any
    q_cmd: NDArray[np.float64]

    @classmethod
    def at_rest(cls, model: CableModel, q_cmd: ArrayLike) -> Self:
        """Return the memory of an arm that is at rest at this command (6,) and whose past is unknown."""
        (q,) = commands(np.asarray(q_cmd, dtype=np.float64)[None])
        return cls(model, model.start(q), q)

    def joints(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (6,) if this command (6,) comes next."""
        return self.model.step(self.state, q_cmd)[0]

    def step(self, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], HysteresisState]:
        """Return the joints (6,) after this command (6,), and the memory."""
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

    def along(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) after each of the commands (n, 6), one after the other."""
        memory, joints = self, np.empty_like(q_cmd)
        for row, q in enumerate(q_cmd):
            joints[row], memory = memory.step(q)
        return joints

    def _is_sample(self, q_cmd: NDArray[np.float64]) -> bool:
        if self.model.rate_independent:
            return True
        interval = self.model.training.interval[WRIST]
        return bool(np.any(np.abs(q_cmd - self.q_cmd)[WRIST] >= np.where(interval > 0, interval, np.inf)))
