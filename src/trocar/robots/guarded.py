"""The innermost wrapper of every robot: it keeps all motions within what the laboratory allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from trocar.arms import ArmModel, MotionLimits, fk
from trocar.cell import JointReading, MotionResult, Robot, SetPoint
from trocar.checks import outside
from trocar.errors import (
    ArmMoving,
    InvalidInput,
    LimitExceeded,
    OutOfReach,
    OutsideWorkspace,
    StaleReading,
    StartMismatch,
    TooNear,
    TrocarError,
    UnknownName,
)
from trocar.geometry import SE3, shown
from trocar.geometry.arrays import Array
from trocar.motion.apart import Apart
from trocar.motion.bodies import MovingArm
from trocar.motion.clearance import swept_clearance
from trocar.motion.limits import limit_use, require_range
from trocar.robots.driver import TICK_S
from trocar.trajectory import Trajectory

TO_BE_GUARDED = "a guard needs what `Driver` has: `remaining`, `braking`, `widest_jaw_rad`, `fault`"
START_TOLERANCE = 1e-6
"""A motion may start this far (rad, m) from the arm's set-point: rounding, not a jump."""
WORKSPACE_STEP_S = 0.010
CLOSER_M = 1e-4
"""Arms that are already too close may come this much closer on their way apart."""
STRETCH_TOLERANCE = 1e-6
"""A limit may be exceeded by this share, because planners use the full limit and floats round."""


@dataclass(frozen=True, eq=False)
class ArmGuard:
    """What one arm is allowed.

    Attributes:
        model: of the arm; positions stay within its joints' ranges.
        limits: of velocity and acceleration.
        T_world_base: its base as registered.
        workspace_m: (2, 3) lower and upper corner, in the world, of a box that the tip may not leave; None: no box.
    """

    model: ArmModel
    limits: MotionLimits
    T_world_base: SE3 = field(default_factory=SE3.identity)
    workspace_m: Array | None = None


@runtime_checkable
class GuardableRobot(Robot, Protocol):
    """A robot that a guard can watch: it tells what it will do next, and lets the guard stop it."""

    def remaining(self, arm: str, /) -> tuple[Trajectory, float] | None:
        """Return the trajectory that an arm is executing and its start on the clock; None at rest."""
        ...

    def braking(self, arm: str, /) -> bool:
        """Return whether an arm is coming to rest before the end of its motion."""
        ...

    def widest_jaw_rad(self, arm: str, /) -> float:
        """Return the widest opening of an arm's jaws from now until they reach their goal."""
        ...

    def fault(self, *arms: str, reason: TrocarError | str) -> None:
        """Bring these arms to rest because something is wrong; their motions end as ``FAULT`` for this reason."""
        ...


@runtime_checkable
class JointEstimator(Protocol):
    """Compensates an arm's cables, so that it can estimate where commands take the joints."""

    def setpoint(self, arm: str) -> SetPoint:
        """Return where the joints are estimated to be."""
        ...

    def expected(self, arm: str) -> Trajectory | None:
        """Return the joint motion expected from the current commands, on their time; None: as commanded."""
        ...


class Guarded:
    """A robot that refuses unsafe motions, slows down motions that are too fast, and stops arms without new readings.

    It checks the joints' positions, velocities and accelerations, jumps in position or velocity at the start of a
    motion, the jaws' range, a workspace for the tip, the distance between arms along their motions, and the age of
    readings. It logs what it had to change as the event ``guard``.

    Args:
        robot: what it wraps.
        arms: what each arm is allowed; an arm that is not here cannot be moved.
        min_distance_m: least distance between the instruments of two arms; 0 or less: not checked.
        stale_s: a reading older than this stops its arm.
        note: called as ``note("guard", arm=..., ...)`` with what was changed.

    Attributes:
        estimator: compensates the cables. Distances between arms are checked at its estimate of the joints; commands
            differ from it by the cables' errors, millimetres at the tip. None: commands are taken as the joints.
    """

    def __init__(
        self,
        robot: GuardableRobot,
        arms: Mapping[str, ArmGuard],
        *,
        min_distance_m: float = 0.0,
        stale_s: float = 0.1,
        note: Callable[..., None] = lambda name, **values: None,
    ):
        if not isinstance(robot, GuardableRobot):
            missing = [name for name in dir(GuardableRobot) if name[0] != "_" and not hasattr(robot, name)]
            raise InvalidInput(f"a robot of type {type(robot).__name__}", f"has no {', '.join(missing)}", TO_BE_GUARDED)
        self._robot, self._arms = robot, dict(arms)
        self._min_distance_m, self._stale_s, self._note = min_distance_m, stale_s, note
        self.estimator: JointEstimator | None = None
        self._stretch = dict.fromkeys(arms, 1.0)
        self._apart: Apart | None = None  # where the arms were last known to be apart
        self._silent: set[str] = set()
        self._braking: set[str] = set()

    def read(self, arm: str) -> JointReading:
        """Return the encoders' state as last read."""
        return self._robot.read(arm)

    def setpoint(self, arm: str) -> SetPoint:
        """Return the current command; ``path_s`` counts along the motion as it was given, before it was slowed down."""
        now, factor = self._robot.setpoint(arm), self._stretch.get(arm, 1.0)
        if factor == 1.0:
            return now
        return replace(now, path_s=now.path_s / factor, path_rate=now.path_rate / factor)

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, all slowed down by one factor if one exceeds its limits.

        Raises:
            MotionRefused: a motion leaves what is allowed; nothing has moved then.
        """
        return await self._robot.move(self._allowed(motions, replaces=False))

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Replace the current motions; from a moving arm, one that is too fast is refused, not slowed down.

        Raises:
            MotionRefused: a motion leaves what is allowed; the current motion then goes on.
        """
        return await self._robot.replace(self._allowed(motions, replaces=True))

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Do nothing: a motion is checked when it starts, since the other arms may move until then."""

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Drive the jaws to an opening within their range."""
        jaw = self._guard(arm).model.jaw
        if not (math.isfinite(angle_rad) and jaw.lower <= angle_rad <= jaw.upper):
            angle, ends = outside(angle_rad, jaw.lower, jaw.upper)
            raise OutOfReach(
                f"jaw angle {angle} rad is outside {ends} of arm {arm!r}",
                arm=arm,
                joint=jaw.name,
                by=max(jaw.lower - angle_rad, angle_rad - jaw.upper),
            )
        return await self._robot.jaw(arm, angle_rad)

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest."""
        self._robot.hold(*arms, reason=reason)

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        await self._robot.rest(*arms)

    def check(self) -> None:
        """Stop every arm whose readings are stale, and every arm that would run into one that brakes.

        The owner of the loop calls this each tick.
        """
        self._require_readings()
        braking = {name for name in self._arms if self._robot.braking(name)}
        if braking - self._braking:  # other motions were free of collisions only as long as that arm moved on
            self._stop_before(braking)
        self._braking = braking

    def _require_readings(self) -> None:
        for name in self._arms:
            now = self._robot.setpoint(name)
            age_s = now.time_s - self._robot.read(name).time_s
            stale = now.moving and age_s > self._stale_s
            if stale:
                reason = StaleReading(name, age_s, self._stale_s)
                self._robot.fault(name, reason=reason)
                if name not in self._silent:  # noted once, though the fault repeats each tick
                    self._note("guard", arm=name, reason=str(reason))
            (self._silent.add if stale else self._silent.discard)(name)

    def _stop_before(self, braking: set[str]) -> None:
        """Stop the other arms whose motions come too close to these braking arms."""
        for name in self._arms:
            remaining = self._robot.remaining(name)
            if name not in braking and remaining is not None:
                too_near = self._too_near({name: remaining})
                if too_near is not None:
                    self._robot.fault(name, reason=too_near)
                    self._note("guard", arm=name, reason=str(too_near))

    def _guard(self, arm: str) -> ArmGuard:
        if arm not in self._arms:
            raise UnknownName("arm", arm, self._arms)
        return self._arms[arm]

    def _allowed(self, motions: Mapping[str, Trajectory], replaces: bool) -> dict[str, Trajectory]:
        """Check the motions; return them, slowed down by one common factor if one is too fast."""
        if not motions:
            raise InvalidInput("a motion", "names no arm", "give a trajectory for each arm that is to move")
        for name in motions:
            self._guard(name)
            if not replaces and self._robot.setpoint(name).moving:
                raise ArmMoving(name)
        factors = {name: self._factor(name, trajectory) for name, trajectory in motions.items()}
        slowest = max(factors, key=lambda name: factors[name])
        factor = factors[slowest]
        if factor <= 1.0 + STRETCH_TOLERANCE:
            factor = 1.0
        elif any(self._robot.setpoint(name).velocity.any() for name in motions):
            raise LimitExceeded(
                f"the motion of arm {slowest!r} takes over from a moving arm and is {factor:.3f} times too fast for "
                "its limits; plan it within them",
                arm=slowest,
                ratio=factor,
            )
        else:
            self._note("guard", arm=slowest, reason="slowed down to its limits", stretch=round(factor, 6))
        sent = {name: trajectory.stretched(factor) for name, trajectory in motions.items()}
        for name, trajectory in sent.items():
            self._require_workspace(name, trajectory)
        now = self._robot.setpoint(slowest).time_s
        too_near = self._too_near({name: (trajectory, now) for name, trajectory in sent.items()})
        if too_near is not None:
            raise too_near.worded(f"{too_near}; plan it further away, or wait")
        for name in sent:
            self._stretch[name] = factor
        return sent

    def _too_near(self, motions: Mapping[str, tuple[Trajectory, float]]) -> TooNear | None:
        """Return the refusal if motions, each with its start on the clock, bring arms too close; else None."""
        if self._min_distance_m <= 0 or len(self._arms) < 2:
            return None
        now = self._robot.setpoint(next(iter(motions))).time_s
        movers = {name: self._mover(name, motion) for name, motion in motions.items()}
        others = {name: self._mover(name, self._robot.remaining(name)) for name in self._arms if name not in motions}
        if self._apart is not None and self._apart.least_m(movers | others) >= self._min_distance_m:
            return None
        end = max(arm.end_s for arm in movers.values())
        clear = swept_clearance(movers, others=others, span_s=(now, max(now, end)), enough_m=self._min_distance_m)
        if clear.distance_m >= self._min_distance_m:
            self._apart = Apart.at(movers | others, now)
            return None
        here = swept_clearance(movers, others=others, span_s=(now, now))
        if here.distance_m < self._min_distance_m and clear.distance_m >= here.distance_m - CLOSER_M:
            return None  # arms that are already too close may move apart
        first, second = clear.between
        return TooNear(
            f"{first} comes within {shown(max(0.0, clear.distance_m), 'm')} of {second} after "
            f"{clear.time_s - now:.2f} s, where {shown(self._min_distance_m, 'm')} are to be kept",
            first=first,
            second=second,
            distance_m=clear.distance_m,
            required_m=self._min_distance_m,
            arms=clear.arms,
        )

    def _mover(self, name: str, motion: tuple[Trajectory, float] | None) -> MovingArm:
        """Return an arm, at its estimated joints, on a motion with its start on the clock; None: at rest."""
        guard, jaw_rad = self._arms[name], self._robot.widest_jaw_rad(name)
        estimator, q_cmd = self.estimator, self._robot.setpoint(name).q
        off = np.zeros_like(q_cmd) if estimator is None else estimator.setpoint(name).q - q_cmd
        if motion is None:
            return MovingArm.resting(guard.model, q_cmd + off, guard.T_world_base, jaw_rad)
        trajectory, start_s = motion
        expected = None if estimator is None else estimator.expected(name)
        if expected is not None and not self._robot.braking(name):
            believed = expected.stretched(trajectory.duration_s / expected.duration_s)
        else:
            shifted = trajectory.coefficients.copy()  # assume that the cables' present error lasts
            shifted[-1] += off
            believed = Trajectory(trajectory.times_s, shifted)
        return MovingArm(guard.model, believed, guard.T_world_base, start_s, jaw_rad)

    def _factor(self, name: str, trajectory: Trajectory) -> float:
        """Return the factor by which a motion has to be slowed down (1 or less: not at all); refuse invalid motions."""
        guard, now = self._guard(name), self._robot.setpoint(name)
        joints = trajectory.coefficients.shape[2]
        if joints != len(guard.model.joints):
            raise InvalidInput(f"the motion of arm {name!r}", f"has {joints} joints", f"give {len(guard.model.joints)}")
        start = trajectory.times_s[0]
        jump = float(np.max(np.abs(trajectory(start) - now.q)))
        if jump > START_TOLERANCE:
            raise start_mismatch(name, jump)
        kick = np.abs(trajectory(start, 1) - now.velocity) - guard.limits.acceleration * TICK_S
        if (kick > 0).any():
            joint = guard.model.joints[int(np.argmax(kick / guard.limits.acceleration))]
            problem = f"starts with a jump in the velocity of joint {joint.name!r}"
            raise StartMismatch(name, problem, "start it with the velocity of its set-point")
        use = limit_use(guard.model, trajectory, guard.limits)
        require_range(guard.model, use)
        return max(use.velocity_ratio, math.sqrt(use.acceleration_ratio))

    def _require_workspace(self, name: str, trajectory: Trajectory) -> None:
        """Refuse a motion that takes the tip out of its box."""
        guard = self._arms[name]
        if guard.workspace_m is None:
            return
        tips = (guard.T_world_base @ fk(guard.model, trajectory.sample(WORKSPACE_STEP_S)[1])).translation_m
        lower, upper = guard.workspace_m
        outside = np.maximum(lower - tips, tips - upper)
        row, axis = np.unravel_index(int(np.argmax(outside)), outside.shape)
        if outside[row, axis] > 0:
            bounds = f"[{shown(lower[axis], 'm')}, {shown(upper[axis], 'm')}]"
            raise OutsideWorkspace(name, f"{'xyz'[axis]} = {shown(tips[row, axis], 'm')}", bounds)


def start_mismatch(arm: str, jump: float) -> StartMismatch:
    """Return the refusal of a motion that starts this far (rad, m) from its arm's set-point."""
    return StartMismatch(arm, f"starts {jump:.6f} rad (or m) away from its set-point", "start it there")
