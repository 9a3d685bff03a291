"""A robot that is pushed off its requested paths, and returns to them: noise injection as in DART.

Demonstrations that never leave their path do not show how to return to it (Laskey et al. 2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trocar.arms import ArmModel, jacobian
from trocar.cell import JointReading, MotionResult, Robot, SetPoint
from trocar.errors import MotionRefused, TrocarError
from trocar.geometry.arrays import Array
from trocar.robots.supervised import Verb
from trocar.trajectory import Trajectory

_BUMP = 64.0 * np.array([-1.0, 3.0, -3.0, 1.0, 0.0, 0.0, 0.0])
"""64 u^3 (1 - u)^3, highest power first: 1 in the middle, and at rest where it begins and ends."""


class Shaken:
    """Plays each motion with a push that is largest half-way; ``setpoint`` reports the requested motion.

    If the robot refuses the pushed motion, the requested one is played.

    Args:
        robot: what it wraps, below any compensation.
        arms: models by name.
        rng: of the pushes.
        push_m: standard deviation of a push along each axis, at the tip.
    """

    def __init__(self, robot: Robot, arms: Mapping[str, ArmModel], rng: np.random.Generator, push_m: float):
        self._robot, self._arms, self._rng, self._push_m = robot, arms, rng, push_m
        self._pushed: dict[str, tuple[Trajectory, Trajectory]] = {}  # the requested motion, without and with its push
        self._asked: dict[str, Trajectory] = {}

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        return self._robot.read(arm)

    def setpoint(self, arm: str) -> SetPoint:
        """Return the requested state of a moving arm; if it rests or left its path, its real command."""
        sent, asked = self._robot.setpoint(arm), self._asked.get(arm)
        if asked is None or not (sent.moving and sent.on_path):
            return sent
        return replace(sent, q=asked(sent.path_s), velocity=sent.path_rate * asked(sent.path_s, 1))

    def push(self, arm: str) -> Array:
        """Return the present offset (6,) of an arm from its requested motion."""
        return self._robot.setpoint(arm).q - self.setpoint(arm).q

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Draw the pushes of motions that come next."""
        self._robot.prepare({arm: self._with_push(arm, motion) for arm, motion in motions.items()})

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, pushed."""
        pushed = {arm: self._with_push(arm, motion) for arm, motion in motions.items()}
        return await self._sent(self._robot.move, motions, pushed)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions, from the requested set-points; what is played begins at the pushed ones."""
        return await self._sent(self._robot.replace, motions, {a: self._back(a, motions[a]) for a in motions})

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws."""
        return await self._robot.jaw(arm, angle_rad)

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest."""
        self._robot.hold(*arms, reason=reason)

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        await self._robot.rest(*arms)

    async def _sent(
        self, verb: Verb, motions: Mapping[str, Trajectory], pushed: Mapping[str, Trajectory]
    ) -> Mapping[str, MotionResult]:
        before = {arm: self._asked.get(arm) for arm in motions}
        self._asked |= motions  # the robot starts them before it first waits
        try:
            return await verb(pushed)
        except MotionRefused:
            self._asked = {arm: asked for arm, asked in (self._asked | before).items() if asked is not None}
            if any(self._robot.setpoint(arm).moving for arm in motions):
                raise
        self._asked |= motions
        return await verb(motions)

    def _with_push(self, arm: str, motion: Trajectory) -> Trajectory:
        """Return a motion with its push, the same one as when it was prepared."""
        known = self._pushed.get(arm)
        if known is None or known[0] is not motion:
            middle, duration_s = motion(motion.times_s[0] + motion.duration_s / 2), motion.duration_s
            joints = self._joints(arm, middle, self._rng.normal(scale=self._push_m, size=3))
            powers = duration_s ** -np.arange(6.0, -1.0, -1.0)
            bump = Trajectory(motion.times_s[[0, -1]], (_BUMP * powers)[:, None, None] * joints)
            self._pushed[arm] = known = motion, motion.plus(bump)
        return known[1]

    def _joints(self, arm: str, q: Array, push_m: Array) -> Array:
        """Return the change of the joints (6,) that moves the tip by a push (3,), using the first three joints only."""
        found = np.zeros(6)
        found[:3] = np.linalg.lstsq(jacobian(self._arms[arm], q)[:3, :3], push_m, rcond=None)[0]
        return found

    def _back(self, arm: str, motion: Trajectory) -> Trajectory:
        """Return a motion that begins where the arm is, and ends where it was requested to end."""
        sent, asked = self._robot.setpoint(arm), self.setpoint(arm)
        off = np.stack([sent.q - asked.q, np.zeros(6)]), np.stack([sent.velocity - asked.velocity, np.zeros(6)])
        return motion.plus(Trajectory.hermite(motion.times_s[[0, -1]], *off)) if np.any(off[0]) else motion
