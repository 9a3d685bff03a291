"""Play operators of many radii with a learned map: memory that lasts as long as the backlash remembers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, commands
from trocar.calibration.models.play_map import PlayMap, fit_linear, fit_map
from trocar.calibration.plant import WRIST, fit_plant, play_slacks
from trocar.calibration.recording import Recording

RADII_RAD = (0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25)
"""Backlash half-widths of the features, beside the one radius identified per joint: a spectrum around the
identified ones (.018 to .128 rad over all instruments), as in a Prandtl-Ishlinskii model."""

OUTER_PENALTY = 10.0
"""Ridge on the outer joints' errors, in standardised commands: about one sample in a hundred."""

PlayBank = NDArray[np.float64]
"""Outputs (3, k) of the play operators: all that the model remembers."""


@dataclass(frozen=True, eq=False)
class PlayModel:
    """``q_joint = q_cmd + offset + map(q4 q5 q6, slacks)`` with slacks ``u - P_r(u)`` of play operators.

    The operators run on ``u = [q4, q5 + a q6, q6 + b q5]`` (the cables of pitch and yaw are coupled);
    column 0 of ``radii`` is the one identified radius of each joint. The map is linear plus a smooth bump
    expansion that dies out away from the training data: outside of it the linear part alone extrapolates.
    The small errors
    of the outer joints q1 q2 q3 are linear in the command.

    Attributes:
        a: share of yaw in the pitch cable's motion.
        b: share of pitch in the yaw cable's motion.
        radii: (3, k) rad.
        offset: (6,) rad and m (q3).
        outer: (3, 6) errors of q1 q2 q3 per unit of command.
        map: from [q4 q5 q6, slacks] to the errors of q4 q5 q6.
        training: the motion it was fitted on.
    """

    name: ClassVar[str] = "play"
    rate_independent: ClassVar[bool] = True
    a: float
    b: float
    radii: NDArray[np.float64]
    offset: NDArray[np.float64]
    outer: NDArray[np.float64]
    map: PlayMap
    training: TrainingMotion

    def __post_init__(self) -> None:
        mix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, self.a], [0.0, self.b, 1.0]])
        object.__setattr__(self, "_mix", mix)

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model: coupling identified, map chosen by validation over blocks of time."""
        plant = fit_plant(recording)
        spectrum = np.broadcast_to(RADII_RAD, (3, len(RADII_RAD)))
        radii = np.column_stack([plant.radii, spectrum])
        slacks = play_slacks(recording.q_cmd, plant.a, plant.b, radii)
        error = (recording.q_phy - recording.q_cmd)[recording.valid]
        outer, offset = fit_linear(recording.q_cmd[recording.valid], error, OUTER_PENALTY)
        outer = outer[:3]
        offset[WRIST] = error[:, WRIST].mean(axis=0)
        features = np.column_stack([recording.q_cmd[:, WRIST], slacks.reshape(len(recording), -1)])
        fitted, constant = fit_map(
            features[recording.valid], error[:, WRIST] - offset[WRIST], np.flatnonzero(recording.valid)
        )
        offset[WRIST] += constant
        return cls(plant.a, plant.b, radii, offset, outer, fitted, TrainingMotion.of(recording))

    def predict(self, q_cmd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints (n, 6) along a history of commands (n, 6) that starts without slack."""
        q = commands(q_cmd)
        slacks = play_slacks(q, self.a, self.b, self.radii).reshape(len(q), -1)
        joints = q + self.offset
        joints[:, :3] += q @ self.outer.T
        joints[:, WRIST] += self.map(np.column_stack([q[:, WRIST], slacks]))
        return joints

    def start(self, q_cmd: NDArray[np.float64]) -> PlayBank:
        """Return the operators (3, k) of an arm without slack at this command (6,)."""
        u = self._mix @ q_cmd[WRIST]  # type: ignore[attr-defined]
        return np.broadcast_to(u[:, None], self.radii.shape)

    def step(self, state: PlayBank, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], PlayBank]:
        """Return the joints (6,) after the command (6,), and the new operators."""
        u, bank = self._bank(state, q_cmd)
        joints = q_cmd + self.offset
        joints[:3] += self.outer @ q_cmd
        joints[WRIST] += self.map(np.concatenate([q_cmd[WRIST], (u - bank).ravel()]))
        return joints, bank

    def linearize(self, state: PlayBank, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joints (6,) after the command and the wrist's Jacobian d q_joint / d q_cmd (3, 3)."""
        u, bank = self._bank(state, q_cmd)
        slack = u - bank
        value, gradient = self.map.linearize(np.concatenate([q_cmd[WRIST], slack.ravel()]))
        joints = q_cmd + self.offset
        joints[:3] += self.outer @ q_cmd
        joints[WRIST] += value
        free = np.abs(slack) < self.radii - 1e-12
        by_slack = (gradient[:, 3:].reshape(3, *free.shape) * free).sum(axis=2)
        return joints, np.eye(3) + gradient[:, :3] + by_slack @ self._mix  # type: ignore[attr-defined]

    def shifted(self, offset: NDArray[np.float64]) -> Self:
        """Return the model with this (6,) added to its prediction."""
        return replace(self, offset=self.offset + offset)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what the file keeps."""
        own = {
            "coupling": np.array([self.a, self.b]),
            "radii": self.radii,
            "offset": self.offset,
            "outer": self.outer,
        }
        return own | self.map.arrays()

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model of a file."""
        a, b = arrays["coupling"].tolist()
        return cls(a, b, arrays["radii"], arrays["offset"], arrays["outer"], PlayMap.from_arrays(arrays), training)

    def _bank(self, state: PlayBank, q_cmd: NDArray[np.float64]) -> tuple[NDArray[np.float64], PlayBank]:
        u = (self._mix @ q_cmd[WRIST])[:, None]  # type: ignore[attr-defined]
        return u, np.minimum(np.maximum(state, u - self.radii), u + self.radii)
