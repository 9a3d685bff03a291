"""The play model: a learned map of play operators of many radii, which remembers as long as real backlash does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from trocar.calibration.models.base import Arrays, TrainingMotion, WithOffset, commands, in_words, shaped
from trocar.calibration.models.play_map import PlayMap, fit_linear, fit_map
from trocar.calibration.plant import WRIST, fit_plant, play_operator, play_slacks
from trocar.calibration.recording import Recording
from trocar.errors import InvalidInput
from trocar.geometry.arrays import Array

RADII_RAD = (0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25)
"""Backlash half-widths of the features, in addition to the one radius identified per joint: a spectrum that covers the
identified radii (.018 to .128 rad over all instruments), as in a Prandtl-Ishlinskii model."""

OUTER_PENALTY = 10.0
"""Ridge penalty for the outer joints' errors, on standardised commands: about one sample in a hundred."""

PlayBank = Array  # outputs (3, k) of the play operators: the whole memory of the model


@dataclass(frozen=True, eq=False)
class PlayResponse:
    """The joints along a path of commands, and their derivatives."""

    joints: Array  # (n, 6) after each command
    state: PlayBank  # (3, k) operators after the last
    by_command: Array  # (n, 3, 3) d wrist's joints / d wrist's command of the same row
    taut: Array  # (n, 3, 3) the same if no operator were in its slack
    # (n, 3, 3, k) d wrist's joints / d operator, of those that the row's own command does not drive
    by_operator: Array
    # (n, 3, k) where in the path each operator was driven last: 2 i by command i, 2 i + 1 by the turn after it; 0 also
    # if never, since what came before the path is as fixed as its first command
    moved: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PlayModel(WithOffset):
    """``q_joint = q_cmd + offset + map(q4 q5 q6, slacks)`` with slacks ``u - P_r(u)`` of play operators.

    The operators run on ``u = [q4, q5 + a q6, q6 + b q5]``, since the cables of pitch and yaw are coupled. The
    map is linear plus smooth bumps that vanish away from the training data, where only the linear part extrapolates.
    The small errors of the outer joints q1 q2 q3 are linear in the command.
    """

    name: ClassVar[str] = "play"
    rate_independent: ClassVar[bool] = True
    a: float  # share of yaw in the motion of the pitch cable
    b: float  # share of pitch in the motion of the yaw cable
    radii: Array  # (3, k) rad
    offset: Array  # (6,) rad and m (q3)
    outer: Array  # (3, 6) errors of q1 q2 q3 per unit of command
    map: PlayMap  # from [q4 q5 q6, slacks] to the errors of q4 q5 q6
    training: TrainingMotion  # the motion it was fitted on

    def __repr__(self) -> str:
        widths = ", ".join(f"{2 * radius:.1f}" for radius in np.degrees(self.radii[:, 0]))
        return in_words(self, f"backlash of q4 q5 q6 {widths} deg, coupling {self.a:.2f} and {self.b:.2f}")

    @cached_property
    def mix(self) -> Array:
        """Return the matrix (3, 3) from the wrist's command to the operators' inputs."""
        return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, self.a], [0.0, self.b, 1.0]])

    @classmethod
    def fit(cls, recording: Recording, rng: np.random.Generator) -> Self:
        """Return the model: coupling identified from the recording, map chosen by validation over blocks of time."""
        plant = fit_plant(recording)
        error = recording.errors[recording.valid]
        outer, offset = fit_linear(recording.q_cmd[recording.valid], error, OUTER_PENALTY)
        radii = with_spectrum(plant.radii)
        fitted, offset[WRIST] = fit_wrist(recording, plant.a, plant.b, radii)
        return cls(plant.a, plant.b, radii, offset, outer[:3], fitted, TrainingMotion.of(recording))

    def predict(self, q_cmd: Array) -> Array:
        """Return the joints (n, 6) for a history of commands (n, 6) that starts without slack."""
        q = commands(q_cmd)
        joints = q + self.offset
        joints[:, :3] += q @ self.outer.T
        joints[:, WRIST] += self.map(wrist_features(q, self.a, self.b, self.radii))
        return joints

    def start(self, q_cmd: Array) -> PlayBank:
        """Return the operators (3, k) of an arm that rests without slack at this command (6,)."""
        u = self.mix @ q_cmd[WRIST]
        return np.broadcast_to(u[:, None], self.radii.shape)

    def step(self, state: PlayBank, q_cmd: Array) -> tuple[Array, PlayBank]:
        """Return the joints (6,) after the command (6,), and the new state of the operators."""
        u, bank = self._bank(state, q_cmd)
        joints = q_cmd + self.offset
        joints[:3] += self.outer @ q_cmd
        joints[WRIST] += self.map(np.concatenate([q_cmd[WRIST], (u - bank).ravel()]))
        return joints, bank

    def linearize(self, state: PlayBank, q_cmd: Array) -> tuple[Array, Array]:
        """Return the joints (6,) after the command, and the wrist's Jacobian d q_joint / d q_cmd (3, 3)."""
        u, bank = self._bank(state, q_cmd)
        slack = u - bank
        value, gradient = self.map.linearize(np.concatenate([q_cmd[WRIST], slack.ravel()]))
        joints = q_cmd + self.offset
        joints[:3] += self.outer @ q_cmd
        joints[WRIST] += value
        # The slack follows the command only within the backlash; at its ends it is constant.
        free = np.abs(slack) < self.radii - 1e-12
        by_slack = (gradient[:, 3:].reshape(3, *free.shape) * free).sum(axis=2)
        return joints, np.eye(3) + gradient[:, :3] + by_slack @ self.mix

    def inputs(self, q_cmd: Array) -> Array:
        """Return the operators' inputs ``[q4, q5 + a q6, q6 + b q5]``, of rates too; (..., 6) -> (..., 3)."""
        return q_cmd[..., WRIST] @ self.mix.T

    def remember(self, state: PlayBank, q_cmd: Array) -> PlayBank:
        """Return the operators (3, k) after commands (n, 6), one after the other."""
        return play_operator(self.inputs(q_cmd)[:, :, None], self.radii, state)[-1]

    def respond(self, state: PlayBank, q_cmd: Array, turns: Array) -> PlayResponse:
        """Return the joints along commands (n, 6), and how they depend on these and on earlier commands.

        Args:
            state: the operators (3, k) before the first command.
            q_cmd: (n, 6), one after the other.
            turns: (n - 1, 3) inputs of the operators where they reverse between a command and the next; if they do not
                reverse, the input at either command.
        """
        u = np.empty((2 * len(q_cmd) - 1, 3, 1))
        u[::2, :, 0], u[1::2, :, 0] = self.inputs(q_cmd), turns
        bank = play_operator(u, self.radii, state)
        free = np.abs(u - bank) < self.radii - 1e-12
        moved = np.maximum.accumulate(np.where(free, 0, np.arange(len(u))[:, None, None]), axis=0)[::2]
        slack, free = (u - bank)[::2], free[::2]
        x = np.concatenate([q_cmd[:, WRIST], slack.reshape(len(q_cmd), -1)], axis=1)
        value, gradient = self.map.slopes(x)
        joints = q_cmd + self.offset
        joints[:, :3] += q_cmd @ self.outer.T
        joints[:, WRIST] += value
        by_slack = gradient[:, :, 3:].reshape(-1, 3, *self.radii.shape) * free[:, None]
        return PlayResponse(
            joints=joints,
            state=bank[-1],
            by_command=np.eye(3) + gradient[:, :, :3] + by_slack.sum(axis=3) @ self.mix,
            taut=np.eye(3) + gradient[:, :, :3],
            by_operator=-by_slack,
            moved=moved,
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for the file."""
        own = {"coupling": np.array([self.a, self.b]), "radii": self.radii, "offset": self.offset, "outer": self.outer}
        return own | self.map.arrays()

    @classmethod
    def from_arrays(cls, arrays: Arrays, training: TrainingMotion) -> Self:
        """Return the model from the arrays of a file."""
        own = shaped(arrays, coupling=(2,), radii=(3, "k"), offset=(6,), outer=(3, 6))
        if (own["radii"] < 0).any():
            raise InvalidInput("'radii'", "holds negative ones")
        a, b = own["coupling"].tolist()
        fitted = PlayMap.from_arrays(arrays, own["radii"].shape[1])
        return cls(a, b, own["radii"], own["offset"], own["outer"], fitted, training)

    def _bank(self, state: PlayBank, q_cmd: Array) -> tuple[Array, PlayBank]:
        u = (self.mix @ q_cmd[WRIST])[:, None]
        return u, np.minimum(np.maximum(state, u - self.radii), u + self.radii)


def with_spectrum(radii: Array) -> Array:
    """Return identified radii (3,) beside those of the spectrum: (3, k) rad."""
    return np.column_stack([radii, np.broadcast_to(RADII_RAD, (3, len(RADII_RAD)))])


def wrist_features(q_cmd: Array, a: float, b: float, radii: Array) -> Array:
    """Return ``[q4 q5 q6, slacks]`` (n, 3 + 3 k) along commands (n, 6), the slacks of each joint in turn."""
    return np.column_stack([q_cmd[:, WRIST], play_slacks(q_cmd, a, b, radii).reshape(len(q_cmd), -1)])


def fit_wrist(recording: Recording, a: float, b: float, radii: Array) -> tuple[PlayMap, Array]:
    """Return the map from :func:`wrist_features` to the errors of q4 q5 q6, and the constant (3,) to add, rad."""
    valid = recording.valid
    error = recording.errors[valid][:, WRIST]
    middle = error.mean(axis=0)
    fitted, constant = fit_map(
        wrist_features(recording.q_cmd, a, b, radii)[valid], error - middle, np.flatnonzero(valid)
    )
    return fitted, middle + constant
