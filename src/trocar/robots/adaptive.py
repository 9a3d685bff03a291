"""A robot that learns its cables while it works, from camera images of its instruments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trocar.arms import ArmModel
from trocar.arms.solids import joint_axes
from trocar.calibration.command_path import CommandPath
from trocar.calibration.compensation import REPLAY_S, HysteresisState
from trocar.calibration.fleet import FleetPrior, Learned, learn_from
from trocar.calibration.models.base import MIN_ROWS
from trocar.calibration.models.play import PlayModel
from trocar.calibration.recording import Recording
from trocar.cell import SetPoint
from trocar.errors import ArmMoving
from trocar.geometry.arrays import Array
from trocar.perception.instrument import Sighting
from trocar.robots.compensated import Compensated

THINNED = 1e-3
"""Commands this close (rad, m) to the straight line between their neighbours are not kept."""
UNLIKELY = float(chdtri(3, 0.001))
"""Squared Mahalanobis distance that one observation in a thousand exceeds by chance."""
SHIFT_SD_M = 0.5e-3
"""SD of an instrument's shift on each axis, due to its registered base and the errors of its outer joints."""
WORST_M = 0.6e-3
"""A sighting whose points are further (SD) than this from the instrument's solids shows something else."""
LEAST_INFORMATION = 1.0
"""1/rad^2, added to the information: a rotation about which an image shows nothing has an SD of one radian."""


class Observation(NamedTuple):
    """A sighting, fitted with the outer joints as commanded, and the index of the last command before it."""

    row: int
    sighting: Sighting


class Combined(NamedTuple):
    """A recording made of observations of the instrument.

    Attributes:
        recording: all commands; measured where there was an observation.
        sd_rad: (n, 3) of the wrist's measurements.
        shift_m: (3,) shift of the instrument from where the commanded outer joints put it, in the arm's base.
    """

    recording: Recording
    sd_rad: Array
    shift_m: Array


class Knowledge(NamedTuple):
    """What observations tell about an arm: the cables of wrist and outer joints, and the shift as in ``Combined``."""

    cables: Learned
    shift_m: Array


@dataclass(eq=False)
class _Past:
    """The commands sent to one arm, and the observations of it.

    Attributes:
        commands: (k, 6) pieces, one after the other.
        path: the command path being sent; None: none yet.
        until_s: time along ``path`` up to which its commands are in ``commands``.
        observations: of the instrument.
    """

    commands: list[Array]
    path: CommandPath | None = None
    until_s: float = 0.0
    observations: list[Observation] = field(default_factory=list)

    def keep(self, path: CommandPath | None, sent: SetPoint) -> None:
        """Store the commands sent since the last call."""
        if path is not self.path:
            self.path, self.until_s = path, 0.0
        if path is not None and sent.path_s > self.until_s:
            times = np.linspace(self.until_s, sent.path_s, 2 + int((sent.path_s - self.until_s) / REPLAY_S))
            self.commands.append(_thinned(path.commands(np.minimum(times, path.commands.duration_s)))[1:])
            self.until_s = sent.path_s
        if np.any(self.commands[-1][-1] != sent.q):  # braking may have left the path
            self.commands.append(sent.q[None])

    @property
    def rows(self) -> int:
        """Return how many commands are kept."""
        return sum(map(len, self.commands))


@dataclass(eq=False)
class Adaptive(Compensated):
    """A robot whose cables are compensated by models that start from a prior and learn from images of the instrument.

    An agent notes the :meth:`moment` of an image, has it fitted, and reports what it showed (:meth:`saw`). It may then
    have the cables fitted again (:meth:`learned`) and, when the arm is at rest, use them (:meth:`adopt`); or correct an
    arm that is still at rest where the image was taken (:meth:`correct`).

    Attributes:
        priors: over instruments and sessions, by arm. The other attributes are those of ``Compensated``.
    """

    priors: Mapping[str, FleetPrior] = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._known: dict[str, Knowledge] = {}
        self._pasts = {arm: _Past([self.robot.setpoint(arm).q[None].copy()]) for arm in self.models}

    def moment(self, arm: str) -> tuple[int, Array]:
        """Return the number of the last command up to now, and the joints (6,) there.

        The wrist joints are the model's estimates, the outer ones are the commands: observations tell how the
        instrument is shifted from these.
        """
        self._keep_past([arm])
        q = self.read(arm).q.copy()
        q[:3] = self.robot.setpoint(arm).q[:3]
        return self._pasts[arm].rows - 1, q

    def saw(self, arm: str, row: int, sighting: Sighting) -> None:
        """Record what an image showed; ``row`` is the number of the last command before it (:meth:`moment`)."""
        self._pasts[arm].observations.append(Observation(row, sighting))

    def learned(self, arm: str) -> Knowledge | None:
        """Return what all observations so far tell about an arm; None while there are too few for a fit."""
        past = self._pasts[arm]
        seen = combine(self.arms[arm], arm, np.concatenate(past.commands), past.observations)
        if seen.recording.valid.sum() < MIN_ROWS:
            return None
        return Knowledge(learn_from(seen.recording, self.priors[arm], seen.sd_rad), seen.shift_m)

    def adopt(self, arm: str, knowledge: Knowledge) -> None:
        """Use what was learned from now on.

        Raises:
            ArmMoving: the arm is moving.
        """
        self._known[arm] = knowledge
        self._take(arm, knowledge.cables.model)

    def spread(self, arm: str) -> Array | None:
        """Return the SDs (3,) of the wrist joints' estimates, rad; None: nothing was adopted yet."""
        known, sent = self._known.get(arm), self.robot.setpoint(arm)
        return None if known is None else known.cables.spread(self._memory(arm, sent).state, sent.q)

    def correct(self, arm: str, seen: Sighting) -> bool:
        """Correct the wrist of an arm that rests where it was seen; image and model are weighted by their certainty.

        The correction lasts until the next :meth:`adopt`, for which the image counts like all other observations
        (:meth:`saw`). An image that contradicts the model by more than their uncertainties explain is rejected.

        Returns:
            whether the image was accepted.

        Raises:
            ArmMoving: the arm is moving.
        """
        known, spread = self._known.get(arm), self.spread(arm)
        if known is None or spread is None or seen.left_m > WORST_M:
            return False
        q, covariance = joints_seen(self.arms[arm], seen, known.shift_m)
        off = q[3:] - self.read(arm).q[3:]
        both = covariance + np.diag(spread**2)
        if off @ np.linalg.solve(both, off) > UNLIKELY:
            return False
        offset = np.zeros(6)
        offset[3:] = spread**2 * np.linalg.solve(both, off)
        self._take(arm, known.cables.model.shifted(offset))
        return True

    def _take(self, arm: str, model: PlayModel) -> None:
        """Switch an arm at rest to another model, whose hysteresis state follows from all commands so far."""
        if self.robot.setpoint(arm).moving:
            raise ArmMoving(arm, "its cable model can be replaced only at rest")
        self._keep_past([arm])
        path = np.concatenate(self._pasts[arm].commands)
        self._rested[arm] = HysteresisState(model, model.remember(model.start(path[0]), path), path[-1])
        self._paths.pop(arm, None)
        self._resting.pop(arm, None)
        self._prepared = {arms: found for arms, found in self._prepared.items() if arm not in arms}

    def _keep_past(self, arms: Iterable[str]) -> None:
        for arm in arms:
            self._pasts[arm].keep(self._paths.get(arm), self.robot.setpoint(arm))


def _thinned(path: Array) -> Array:
    """Return a path (n, 6) without the points that lie on the straight lines between the others."""
    if len(path) < 3:
        return path
    share = np.linspace(0.0, 1.0, len(path))[:, None]
    away = np.abs(path - ((1.0 - share) * path[0] + share * path[-1])).max(axis=1)
    farthest = int(away.argmax())
    if away[farthest] <= THINNED:
        return path[[0, -1]]
    return np.concatenate([_thinned(path[: farthest + 1])[:-1], _thinned(path[farthest:])])


def combine(arm: ArmModel, name: str, q_cmd: Array, observations: Sequence[Observation]) -> Combined:
    """Return the recording made of observations.

    The shift of the instrument is common to all observations and is found from all of them; then each of them gives its
    wrist joints.

    Args:
        arm: whose instrument was seen.
        name: of the recording.
        q_cmd: (n, 6) all commands that were sent, including where they reversed; rad and m.
        observations: in order.
    """
    good = [observation for observation in observations if observation.sighting.left_m < WORST_M]
    shift_m = _common_shift(good)
    measured, sd = np.full_like(q_cmd, np.nan), np.ones((len(q_cmd), 3))
    for row, sighting in good:
        measured[row], covariance = joints_seen(arm, sighting, shift_m)
        sd[row] = np.sqrt(np.diag(covariance))
    valid: NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(axis=1))
    return Combined(Recording(q_cmd, measured, valid, np.arange(len(q_cmd), dtype=np.float64), name), sd, shift_m)


def _common_shift(observations: Sequence[Observation]) -> Array:
    """Return the most likely shift (3,) given all observations, marginalised over the wrist joints in each."""
    information, pull = np.eye(3) / SHIFT_SD_M**2, np.zeros(3)
    for _, seen in observations:
        across = seen.information[3:, :3] @ _of_wrist(seen)
        known = seen.information[3:, 3:] - across @ seen.information[:3, 3:]
        information += known
        pull += known @ seen.shift_m + seen.pull[3:] - across @ seen.pull[:3]
    return np.asarray(np.linalg.solve(information, pull), dtype=np.float64)


def joints_seen(arm: ArmModel, seen: Sighting, shift_m: Array) -> tuple[Array, Array]:
    """Return the joints (6,) in a sighting for this shift of the instrument, and the wrist's covariance (3, 3)."""
    covariance, q = _of_wrist(seen), seen.q.copy()
    q[3:] += covariance @ (seen.pull[:3] - seen.information[:3, 3:] @ (shift_m - seen.shift_m))
    axes, origins = joint_axes(arm, q)
    by_outer = np.column_stack([*np.cross(axes[:2], origins[5] - origins[:2]), axes[2]])
    q[:3] += np.linalg.solve(by_outer, shift_m)
    return q, covariance


def _of_wrist(seen: Sighting) -> Array:
    """Return the covariance (3, 3) of the wrist in a sighting, given the shift."""
    return np.asarray(np.linalg.inv(seen.information[:3, :3] + LEAST_INFORMATION * np.eye(3)), dtype=np.float64)
