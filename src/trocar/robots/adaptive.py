"""A robot that learns its cables while it works, from camera images of its instruments."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trocar.arms import ArmModel, MotionLimits
from trocar.calibration.command_path import CommandPath
from trocar.calibration.compensation import REPLAY_S, HysteresisState
from trocar.calibration.fleet import FleetPrior, Learned, learn_from
from trocar.calibration.models.base import MIN_ROWS, CableModel
from trocar.calibration.models.play import PlayModel
from trocar.cell import Clock, Log, MotionResult, Robot, SetPoint
from trocar.errors import ArmMoving
from trocar.perception.instrument import Sighting
from trocar.robots.compensated import Compensated
from trocar.robots.observations import WORST_M, Observation, combine, joints_seen
from trocar.trajectory import Trajectory

THINNED = 1e-3
"""Commands this close (rad, m) to the straight line between their neighbours are not kept."""
UNLIKELY = float(chdtri(3, 0.001))
"""Squared Mahalanobis distance that one observation in a thousand exceeds by chance."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What observations reveal about an arm.

    Attributes:
        cables: of its wrist and outer joints.
        shift_m: (3,) shift of its instrument from where the commanded outer joints put it, in its base.
    """

    cables: Learned
    shift_m: NDArray[np.float64]


@dataclass(eq=False)
class _Past:
    """What was sent to one arm, and what was seen of it.

    Attributes:
        commands: (k, 6) pieces, one after the other.
        path: the one being sent; None: none yet.
        until_s: time up to which its commands are among the pieces.
        observations: of the instrument.
    """

    commands: list[NDArray[np.float64]]
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
        if np.any(self.commands[-1][-1] != sent.q):
            self.commands.append(sent.q[None])

    @property
    def rows(self) -> int:
        """Return how many commands are kept."""
        return sum(map(len, self.commands))


class Adaptive(Compensated):
    """A robot whose cables are compensated by models that start from a prior and learn from images of the instrument.

    An agent notes the :meth:`moment` of an image, has it fitted, and reports what it showed (:meth:`saw`). It may then
    have the cables fitted again (:meth:`learned`) and, when the arm is at rest, use them (:meth:`adopt`); or correct an
    arm that is still at rest where the image was taken (:meth:`correct`).

    Args:
        robot: what it wraps, see ``Compensated``.
        arms: models by name.
        models: cable models of the arms to begin with.
        priors: over instruments and sessions, by arm.
        limits: of velocity and acceleration of the commands, by arm.
        clock: of the cell.
        log: of the cell.
    """

    def __init__(
        self,
        robot: Robot,
        arms: Mapping[str, ArmModel],
        models: Mapping[str, CableModel],
        priors: Mapping[str, FleetPrior],
        limits: Mapping[str, MotionLimits],
        clock: Clock,
        log: Log,
    ):
        super().__init__(robot, arms, models, limits, clock, log)
        self._priors = dict(priors)
        self._known: dict[str, Knowledge] = {}
        self._pasts = {arm: _Past([robot.setpoint(arm).q[None].copy()]) for arm in models}

    def moment(self, arm: str) -> tuple[int, NDArray[np.float64]]:
        """Return the number of the last command up to now, and the joints (6,) there.

        The wrist joints are where the model estimates them, the outer ones where they are commanded: observations are
        compared by how the instrument is shifted from these.
        """
        past, sent = self._pasts[arm], self._robot.setpoint(arm)
        past.keep(self._paths.get(arm), sent)
        q = self.read(arm).q.copy()
        q[:3] = sent.q[:3]
        return past.rows - 1, q

    def saw(self, arm: str, row: int, sighting: Sighting) -> None:
        """Note what an image showed that was taken after that command had been sent."""
        self._pasts[arm].observations.append(Observation(row, sighting))

    def learned(self, arm: str) -> Knowledge | None:
        """Return what all observations so far tell about an arm; None while there are too few for a fit."""
        past = self._pasts[arm]
        seen = combine(self._arms[arm], arm, np.concatenate(past.commands), past.observations)
        if seen.recording.valid.sum() < MIN_ROWS:
            return None
        return Knowledge(learn_from(seen.recording, self._priors[arm], seen.sd_rad), seen.shift_m)

    def adopt(self, arm: str, knowledge: Knowledge) -> None:
        """From now on, use what was learned.

        Raises:
            ArmMoving: the arm is moving.
        """
        self._known[arm] = knowledge
        self._take(arm, knowledge.cables.model)

    def spread(self, arm: str) -> NDArray[np.float64] | None:
        """Return the SDs (3,) of the wrist joints about their estimates, rad; None: nothing was learned yet."""
        known = self._known.get(arm)
        if known is None:
            return None
        q_cmd = self._robot.setpoint(arm).q
        return known.cables.spread(self._memory(arm, self._robot.setpoint(arm)).state, q_cmd)

    def correct(self, arm: str, seen: Sighting) -> bool:
        """Correct an arm that rests where it was seen, to the extent that the image is more certain than the model.

        The correction holds until something is adopted; the image then counts along with all other observations. An
        image that contradicts the model by more than both can explain is rejected.

        Returns:
            whether the image was accepted.

        Raises:
            ArmMoving: the arm is moving.
        """
        known, spread = self._known.get(arm), self.spread(arm)
        if known is None or spread is None or seen.left_m > WORST_M:
            return False
        q, covariance = joints_seen(self._arms[arm], seen, known.shift_m)
        off = q[3:] - self.read(arm).q[3:]
        both = covariance + np.diag(spread**2)
        if off @ np.linalg.solve(both, off) > UNLIKELY:
            return False
        offset = np.zeros(6)
        offset[3:] = spread**2 * np.linalg.solve(both, off)
        self._take(arm, known.cables.model.shifted(offset))
        return True

    def _take(self, arm: str, model: PlayModel) -> None:
        sent, past = self._robot.setpoint(arm), self._pasts[arm]
        if sent.moving:
            raise ArmMoving(arm, "its cable model can be replaced only at rest")
        past.keep(self._paths.get(arm), sent)
        path = np.concatenate(past.commands)
        self._rested[arm] = HysteresisState(model, model.remember(model.start(path[0]), path), path[-1])
        self._paths.pop(arm, None)
        self._resting.pop(arm, None)
        self._prepared = {arms: found for arms, found in self._prepared.items() if arm not in arms}

    async def _sent(
        self,
        verb: Callable[[Mapping[str, Trajectory]], Awaitable[Mapping[str, MotionResult]]],
        motions: Mapping[str, Trajectory],
        paths: Mapping[str, CommandPath],
    ) -> Mapping[str, MotionResult]:
        for arm in paths:
            self._pasts[arm].keep(self._paths.get(arm), self._robot.setpoint(arm))
        return await super()._sent(verb, motions, paths)


def _thinned(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a path (n, 6) without the points that lie on the straight lines between the others."""
    if len(path) < 3:
        return path
    share = np.linspace(0.0, 1.0, len(path))[:, None]
    away = np.abs(path - ((1.0 - share) * path[0] + share * path[-1])).max(axis=1)
    farthest = int(away.argmax())
    if away[farthest] <= THINNED:
        return path[[0, -1]]
    return np.concatenate([_thinned(path[: farthest + 1])[:-1], _thinned(path[farthest:])])
