"""Description of a robot type: joints, geometry, limits, instrument."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms.instrument import Instrument
from trocar.errors import InvalidInput
from trocar.geometry import TURN, shown, shown_scale
from trocar.geometry.arrays import Array, finite
from trocar.notebook import table


@dataclass(frozen=True)
class Joint:
    """One joint, in rad and s, or m and s if prismatic.

    Attributes:
        name: unique within the arm.
        lower: lower position limit.
        upper: upper position limit.
        max_speed: maximum speed of the controller's default trajectories.
        max_acceleration: maximum acceleration of these trajectories.
        prismatic: whether the joint slides.
    """

    name: str
    lower: float
    upper: float
    max_speed: float
    max_acceleration: float
    prismatic: bool = False

    def __post_init__(self) -> None:
        finite(f"joint '{self.name}'", (self.lower, self.upper, self.max_speed, self.max_acceleration), 4)
        if not self.lower < self.upper:
            problem = f"has limits {self.lower} to {self.upper} {self.unit}"
            raise InvalidInput(f"joint '{self.name}'", problem, "give lower < upper")
        if not (self.max_speed > 0 and self.max_acceleration > 0):
            problem = f"has speed {self.max_speed} and acceleration {self.max_acceleration}"
            raise InvalidInput(f"joint '{self.name}'", problem, "both must be above 0")

    @property
    def unit(self) -> str:
        """Return 'm' for a prismatic joint, else 'rad'."""
        return "m" if self.prismatic else "rad"

    @property
    def shown_scale(self) -> tuple[float, str]:
        """Return the factor and the unit that show the joint's values to people: mm if it slides, else deg."""
        return shown_scale(self.unit)

    def shown(self, value: float, spec: str = ".1f") -> str:
        """Return a value of this joint as text in mm or deg, such as ``'12.3 deg'``."""
        return shown(value, self.unit, spec)

    @property
    def middle(self) -> float:
        """Return the middle of the range."""
        return (self.lower + self.upper) / 2


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of joint velocity and acceleration, symmetric about zero.

    Attributes:
        velocity: (joints,) rad/s, or m/s for prismatic joints.
        acceleration: (joints,) rad/s^2 or m/s^2.
        jerk: (joints,) rad/s^3 or m/s^3; None: unlimited. A jerk limit also forbids jumps of the acceleration.
    """

    velocity: Array
    acceleration: Array
    jerk: Array | None = None

    def __post_init__(self) -> None:
        given = {"velocity": self.velocity, "acceleration": self.acceleration, "jerk": self.jerk}
        bounds = {n: finite(f"{n} of motion limits", value, ...) for n, value in given.items() if value is not None}
        shapes = {name: value.shape for name, value in bounds.items()}
        if bounds["velocity"].ndim != 1 or len(set(shapes.values())) > 1:
            raise InvalidInput("motion limits", f"need one number per joint of each, got shapes {shapes}")
        for name, value in bounds.items():
            if not np.all(value > 0):
                raise InvalidInput("motion limits", f"must be above 0, got {name} {value.tolist()}")
            object.__setattr__(self, name, value)

    def scaled(self, share: float) -> MotionLimits:
        """Return the limits, each multiplied by ``share``."""
        if share == 1.0:
            return self
        jerk = None if self.jerk is None else share * self.jerk
        return MotionLimits(share * self.velocity, share * self.acceleration, jerk)

    def slowed(self, share: float) -> MotionLimits:
        """Return the limits with which the same paths take 1 / share times as long, share in (0, 1]."""
        if share == 1.0:
            return self
        jerk = None if self.jerk is None else share**3 * self.jerk
        return MotionLimits(share * self.velocity, share**2 * self.acceleration, jerk)


class Branch(NamedTuple):
    """One of the eight solutions of the inverse kinematics, by the signs of cos q6, cos q5 and sin(q2 + offset)."""

    yaw: int
    wrist: int
    pitch: int


BRANCHES = tuple(Branch(u6, u5, u2) for u6 in (1, -1) for u5 in (1, -1) for u2 in (1, -1))
"""All branches, in the order of ``ik_branches``."""


class SolverConstants(NamedTuple):
    """Constants of one branch of one arm: c, s are cosines and sines of the twists, u the sign of sin(q2 + offset).

    The ``offsets`` are subtracted from the angles.
    """

    branch: Branch
    wrist_sign: int
    wrist_length_m: float
    tip_length_m: float
    c0: float
    s0: float
    c1c2: float
    s1s2: float
    s1c2: float
    c1s2: float
    u_s1: float
    u_s2: float
    offsets: tuple[float, ...]


@dataclass(frozen=True)
class ArmModel:
    """An arm with a remote centre: yaw, pitch, insertion, roll, wrist pitch, wrist yaw, and jaws at the tip.

    Modified DH, ``T_i = Rx(alpha) Tx(a) Rz(theta) Tz(d)`` with joint variable q and offset o::

        i    alpha               a               d          theta
        1    twists_rad[0]       0               0          q1 + o1
        2    twists_rad[1]       0               0          q2 + o2
        3    twists_rad[2]       0               q3 + o3    0
        4    0                   0               0          q4 + o4
        5    wrist_sign * pi/2   0               0          q5 + o5 - pi/2
        6    wrist_sign * pi/2   wrist_length_m  0          q6 + o6 - pi/2

    The remote centre is the origin of frame 0. The tip lies ``tip_length_m`` along +y of frame 6. The z axis of its
    frame points back along the jaws, and y along -z of frame 6 (the jaw axis), so that the PSM's tip is parallel to its
    base at q = 0.

    Attributes:
        name: key in ``ARMS``.
        joints: six, in order.
        twists_rad: angles between base z, axis 1, axis 2, axis 3.
        offsets: six, rad or m, added to q.
        wrist_sign: +1 or -1, the handedness of the wrist; the tool points along -wrist_sign * z of frame 4.
        wrist_length_m: from the wrist pitch axis to the wrist yaw (jaw) axis, L3 or Lw.
        tip_length_m: from the jaw axis to the controlled point, L4.
        jaw: the opening of the jaws, as a joint.
        instrument: the solid shapes of what is mounted on the arm.
        safe_depth_m: minimum depth of the wrist beyond the remote centre for Cartesian motion.
        coupling: (4, 4) joints from actuators, for roll, wrist pitch, wrist yaw, jaw; None if unknown.
    """

    name: str
    joints: tuple[Joint, ...]
    twists_rad: tuple[float, float, float]
    offsets: tuple[float, ...]
    wrist_sign: int
    wrist_length_m: float
    tip_length_m: float
    jaw: Joint
    instrument: Instrument
    safe_depth_m: float
    coupling: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        item = f"arm '{self.name}'"
        if len(self.joints) != 6 or len(self.offsets) != 6:
            raise InvalidInput(item, f"needs 6 joints and offsets, got {len(self.joints)} and {len(self.offsets)}")
        finite(f"twists_rad of {item}", self.twists_rad, 3)
        finite(f"offsets of {item}", self.offsets, 6)
        lengths = finite(item, (self.wrist_length_m, self.tip_length_m, self.safe_depth_m), 3)
        if lengths.min() < 0:
            raise InvalidInput(item, f"has wrist, tip and safe depth {lengths.tolist()} m", "none may be below 0")
        if self.coupling is not None:
            finite(f"the coupling of {item}", self.coupling, 4, 4)
        if [joint.prismatic for joint in self.joints] != [False, False, True, False, False, False]:
            raise InvalidInput(item, "needs exactly its third joint to be prismatic")
        if self.wrist_sign not in (-1, 1):
            raise InvalidInput(item, f"has wrist_sign {self.wrist_sign}", "choose -1 or 1")
        if abs(math.sin(self.twists_rad[1]) * math.sin(self.twists_rad[2])) < 1e-6:
            raise InvalidInput(item, f"has parallel axes: twists {self.twists_rad} rad")

    def __repr__(self) -> str:
        names = ", ".join(joint.name for joint in self.joints)
        return f"<ArmModel {self.name!r}: joints {names}; tip {shown(self.tip_length_m, 'm')} beyond the jaws' axis>"

    def _repr_html_(self) -> str:
        rows = []
        for j in (*self.joints, self.jaw):
            paces = f"{j.shown(j.max_speed)}/s", f"{j.shown(j.max_acceleration)}/s²"
            rows.append((j.name, j.shown(j.lower), j.shown(j.upper), *paces))
        return table(self, ("joint", "from", "to", "speed up to", "acceleration up to"), rows)

    def widened(self, rad: float, m: float) -> ArmModel:
        """Return the arm with its ranges widened at both ends: by an angle, or by a length for a prismatic joint."""
        more = ((joint, m if joint.prismatic else rad) for joint in self.joints)
        return replace(self, joints=tuple(replace(j, lower=j.lower - by, upper=j.upper + by) for j, by in more))

    @cached_property
    def lower(self) -> Array:
        """Return the lower limits (6,)."""
        return _frozen([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> Array:
        """Return the upper limits (6,)."""
        return _frozen([joint.upper for joint in self.joints])

    @cached_property
    def middle(self) -> Array:
        """Return the middle of every range (6,)."""
        return _frozen([joint.middle for joint in self.joints])

    @cached_property
    def middle_floats(self) -> list[float]:
        """Return ``middle`` as a list, for scalar code."""
        return self.middle.tolist()

    @cached_property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Return the lower and upper limit of each joint, for scalar code."""
        return tuple((joint.lower, joint.upper) for joint in self.joints)

    @cached_property
    def turns(self) -> Array:
        """Return the period (6,) of each joint: a whole turn for rotary joints, 0 for prismatic ones."""
        return _frozen([0.0 if joint.prismatic else TURN for joint in self.joints])

    @cached_property
    def turn_targets(self) -> tuple[tuple[int, float, float], ...]:
        """Return (joint, low, high) for yaw and roll: the solver clips a reference to them and takes the nearest turn.

        Only a range of more than one turn leaves a choice; in a smaller one, low and high are both the middle.
        """
        targets = []
        for i in (0, 3):
            joint = self.joints[i]
            spare = max(0.0, (joint.upper - joint.lower) / 2 - math.pi)
            targets.append((i, joint.middle - spare, joint.middle + spare))
        return tuple(targets)

    @cached_property
    def branch(self) -> Branch:
        """Return the branch of the inverse kinematics that contains the middle of the ranges."""
        q = self.middle
        t2, t5, t6 = q[1] + self.offsets[1], q[4] + self.offsets[4], q[5] + self.offsets[5]
        signs = math.cos(t6), math.cos(t5), math.sin(t2)
        return Branch(*(1 if sign >= 0 else -1 for sign in signs))

    @cached_property
    def branch_is_unique(self) -> bool:
        """Return whether the ranges of pitch and wrist lie entirely within that branch."""
        q_center = self._branch_center - np.array(self.solver_offsets)
        inside = np.maximum(abs(self.lower - q_center), abs(self.upper - q_center)) <= math.pi / 2 + 1e-9
        return bool(inside[[1, 4, 5]].all())

    @cached_property
    def solver_offsets(self) -> tuple[float, ...]:
        """Return the offsets; pitch and wrist are shifted by whole turns so that solutions lie in their ranges."""
        offsets = np.array(self.offsets)
        pinned = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 1.0]) * TURN
        turns = np.rint((self._branch_center - offsets - self.middle) / TURN)
        return tuple((offsets + pinned * turns).tolist())

    @cached_property
    def solver_constants(self) -> SolverConstants:
        """Return the constants of the inverse kinematics on the arm's own branch."""
        return self.constants(self.branch, self.solver_offsets)

    def constants(self, branch: Branch, offsets: tuple[float, ...]) -> SolverConstants:
        """Return the constants of the inverse kinematics on any branch, with offsets known up to whole turns."""
        (c0, s0), (c1, s1), (c2, s2) = self.twist_cosines
        u = branch.pitch
        lengths = self.wrist_length_m, self.tip_length_m
        products = c1 * c2, s1 * s2, s1 * c2, c1 * s2, u * s1, u * s2
        return SolverConstants(branch, self.wrist_sign, *lengths, c0, s0, *products, offsets)

    @cached_property
    def _branch_center(self) -> Array:
        yaw, wrist, pitch = self.branch
        half = math.pi / 2
        return np.array([0.0, pitch * half, 0.0, 0.0, half - wrist * half, half - yaw * half])

    @cached_property
    def twist_cosines(self) -> tuple[tuple[float, float], ...]:
        """Return cosine and sine of each twist, with exact zeros at right angles."""
        pairs = ((math.cos(twist), math.sin(twist)) for twist in self.twists_rad)
        return tuple(tuple(0.0 if abs(x) < 1e-15 else x for x in pair) for pair in pairs)  # type: ignore[return-value]

    @cached_property
    def motion_limits(self) -> MotionLimits:
        """Return the velocity and acceleration limits of the joints."""
        return MotionLimits(
            np.array([joint.max_speed for joint in self.joints]),
            np.array([joint.max_acceleration for joint in self.joints]),
        )

    def configurations(self, q: ArrayLike) -> Array:
        """Return ``q`` as (..., 6) floats (TrocarError: the last axis is not six long, or a value is not finite)."""
        return finite(f"a configuration of arm '{self.name}'", q, ..., 6)


def _frozen(values: list[float]) -> Array:
    array = np.array(values)
    array.flags.writeable = False
    return array
