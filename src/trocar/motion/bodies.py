"""What moves and what is in its way: arms on known motions, obstacles, and their capsules over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, product
from math import ceil, factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import SOLIDS, ArmModel, capsules, wrist_depth_m
from trocar.arms.solids import solid_radii_m
from trocar.errors import InvalidInput
from trocar.geometry import SE3, direction
from trocar.geometry.arrays import Array, finite
from trocar.geometry.capsules import Capsules
from trocar.geometry.se3 import one_pose
from trocar.motion.limits import hulls
from trocar.trajectory import Trajectory

INSERTION = 2  # the joint that slides; all axes before it and the roll after it pass through the remote centre
BALL_RADIUS_M = 1e7  # of the ball that represents a half-space: flat within 1 um over 4 m; rounding stays below 10 nm
BALL_LIFT_M = 1e-6  # how far that ball is raised, so that it contains all of the half-space nearby
GAP_M = 1.5e-3  # greatest gap between two rows of a wall: nothing 2 mm thick fits through
HIGHEST_M = 10.0


@dataclass(frozen=True, eq=False)
class MovingArm:
    """An arm on a trajectory, in the world; it rests before and after.

    >>> waiting = MovingArm.resting(arm, q_now, T_world_right)
    >>> MovingArm(arm, trajectory, T_world_left, start_s=-0.2).ends_m(0.0).shape  # has been moving for .2 s
    (4, 2, 3)

    Attributes:
        model: of the arm.
        trajectory: of its six joints, without jumps; its own time starts at its first knot.
        T_world_base: pose of its base.
        start_s: when it starts, on the caller's clock; below 0 if it is already running.
        jaw_rad: opening between the fingers.
    """

    model: ArmModel
    trajectory: Trajectory
    T_world_base: SE3 = field(default_factory=SE3.identity)
    start_s: float = 0.0
    jaw_rad: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_base", one_pose(f"T_world_base of {self.model.name}", self.T_world_base))
        joints = self.trajectory.coefficients.shape[2]
        if joints != len(self.model.joints):
            raise InvalidInput(self.model.name, f"has {len(self.model.joints)} joints, its trajectory {joints}")
        if not (np.isfinite(self.start_s) and np.isfinite(self.jaw_rad)):
            problem = f"of {self.model.name} starts at {self.start_s} s, jaws at {self.jaw_rad} rad"
            raise InvalidInput("a motion", problem, "give finite numbers")

    def __repr__(self) -> str:
        return f"<MovingArm {self.model.name} from {self.start_s:.3f} s to {self.end_s:.3f} s>"

    @classmethod
    def resting(cls, model: ArmModel, q: ArrayLike, T_world_base: SE3 | None = None, jaw_rad: float = 0.0) -> MovingArm:
        """Return an arm that stays at these joints (6,)."""
        hold = Trajectory(np.array([0.0, 1e-3]), model.configurations(q)[None, None])
        return cls(model, hold, T_world_base or SE3.identity(), 0.0, jaw_rad)

    @property
    def end_s(self) -> float:
        """Return when the arm comes to rest, on the caller's clock."""
        return self.start_s + self.trajectory.duration_s

    @property
    def knots_s(self) -> Array:
        """Return the knots of its trajectory on the caller's clock."""
        return self.trajectory.times_s + (self.start_s - self.trajectory.times_s[0])

    def joints(self, t_s: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of this order of the joints at the times (...,): (..., 6)."""
        shift = self.trajectory.times_s[0] - self.start_s
        return self.trajectory(np.asarray(t_s, dtype=np.float64) + shift, order)

    @property
    def rests(self) -> bool:
        """Return whether its trajectory is one constant."""
        return self.trajectory.coefficients.shape[:2] == (1, 1)

    def ends_m(self, t_s: ArrayLike) -> Array:
        """Return the ends of the instrument's capsules in the world at the times (...,): (..., 4, 2, 3) m."""
        if self.rests and np.ndim(t_s):
            return np.broadcast_to(self.ends_m(self.start_s), (*np.shape(t_s), len(SOLIDS), 2, 3))
        return capsules(self.model, self.joints(t_s), self.jaw_rad).moved(self.T_world_base).ends_m


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within a radius of a segment, in the world; with one end it is a ball.

    >>> peg = Capsule([0.05, 0.0, 0.0], [0.05, 0.0, 0.02], radius_m=0.002)
    >>> ball = Capsule([0.0, 0.0, 0.1], radius_m=0.01)

    Attributes:
        start_m: (3,).
        end_m: (3,); None: where it starts.
        radius_m: 0 or more.
    """

    start_m: Array
    end_m: Array | None = None
    radius_m: float = 0.0

    def __post_init__(self) -> None:
        end = self.start_m if self.end_m is None else self.end_m
        object.__setattr__(self, "start_m", finite("the start of a capsule", self.start_m, 3))
        object.__setattr__(self, "end_m", finite("the end of a capsule", end, 3))
        if not (np.isfinite(self.radius_m) and self.radius_m >= 0):
            raise InvalidInput("the radius", f"of a capsule is {self.radius_m} m", "give a finite radius of at least 0")


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """All points on one side of a plane, in the world: a table, a wall.

    >>> table = HalfSpace(point_m=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])

    Attributes:
        point_m: (3,) on the plane, not more than about 4 m from the arms.
        normal: (3,) pointing out of the solid side, of any length; a unit vector afterwards.
    """

    point_m: Array
    normal: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_m", finite("the point of a half-space", self.point_m, 3))
        object.__setattr__(self, "normal", direction(self.normal, "the normal of a half-space"))


Obstacle = Capsule | HalfSpace


def stacked(obstacles: Mapping[str, Obstacle]) -> Capsules:
    """Return the obstacles in order as capsules in the world: ends (k, 2, 3) m, radii (k,).

    A half-space becomes a ball so large that it is flat near the arms, and contains the half-space there. So planners,
    checks and guards need only one shape.
    """
    ends, radii = np.zeros((len(obstacles), 2, 3)), np.zeros(len(obstacles))
    for k, thing in enumerate(obstacles.values()):
        if isinstance(thing, HalfSpace):
            ends[k], radii[k] = thing.point_m + (BALL_LIFT_M - BALL_RADIUS_M) * thing.normal, BALL_RADIUS_M
        else:
            ends[k], radii[k] = (thing.start_m, thing.end_m), thing.radius_m
    return Capsules(ends, radii)


def wall(name: str, start_m: ArrayLike, end_m: ArrayLike, height_m: float, radius_m: float) -> dict[str, Capsule]:
    """Return an upright wall as rows of capsules, from its foot to its top, by name.

    >>> list(wall("fence", [0, 0, 0], [0.1, 0, 0], height_m=0.01, radius_m=0.002))
    ['fence 0', 'fence 1', 'fence 2']

    Args:
        name: of the wall; rows are numbered.
        start_m: (3,) of its foot in the world, in the middle of its thickness.
        end_m: (3,) where its foot ends.
        height_m: from the foot to the top, along z of the world.
        radius_m: half its thickness.
    """
    if not (0 < 2 * radius_m <= height_m <= HIGHEST_M):
        problem = f"cannot be {height_m} m high and {2 * radius_m} m thick"
        advice = f"give a thickness above 0, and a height of at least that and at most {HIGHEST_M} m"
        raise InvalidInput("a wall", problem, advice)
    rows = ceil((height_m - 2 * radius_m) / (2 * radius_m + GAP_M) - 1e-9) + 1
    ends = finite(f"the foot of wall {name!r}", [start_m, end_m], 2, 3)  # type: ignore[list-item]
    heights_m = np.linspace(radius_m, height_m - radius_m, rows) if rows > 1 else [radius_m]
    feet = [ends + h * np.array([0.0, 0.0, 1.0]) for h in heights_m]
    return {f"{name} {k}": Capsule(*both, radius_m=radius_m) for k, both in enumerate(feet)}


def open_box(
    name: str, T_world_box: SE3, inside_m: tuple[float, float], height_m: float, radius_m: float
) -> dict[str, Capsule]:
    """Return the four walls of a box without lid and floor, by name: a receptacle on a table.

    >>> receptacle = open_box("receptacle", T_world_left, (0.11, 0.07), 0.02, 0.002)

    Args:
        name: of the box; walls and rows are numbered.
        T_world_box: pose of the middle of its floor, z straight up.
        inside_m: its length along x and y, between the walls.
        height_m: of the walls.
        radius_m: half the thickness of the walls, which are outside of ``inside_m``.
    """
    if not min(finite(f"the inside of box {name!r}", inside_m, 2)) > 0:
        raise InvalidInput(f"box {name!r}", f"is {inside_m} m wide inside", "give two lengths above 0")
    x, y = (length / 2 + radius_m for length in inside_m)
    corners = T_world_box.apply(np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]))
    walls: dict[str, Capsule] = {}
    for k in range(4):
        walls |= wall(f"{name} {k}", corners[k], corners[(k + 1) % 4], height_m, radius_m)
    return walls


@dataclass(frozen=True, eq=False)
class Bodies:
    """The capsules of moving arms, then those of obstacles, and the pairs of them to be compared."""

    movers: tuple[MovingArm, ...]  # the arms, four capsules each
    still: Capsules  # the obstacles
    names: tuple[str, ...]  # of every capsule, as in ``"psm1 left finger"``
    radii_m: Array  # (bodies,)
    pairs: NDArray[np.intp]  # (pairs, 2) indices of bodies
    owners: tuple[str, ...] = ()  # name of the arm that each of the movers' capsules belongs to

    @classmethod
    def of(
        cls, arms: Mapping[str, MovingArm], others: Mapping[str, MovingArm], obstacles: Mapping[str, Obstacle]
    ) -> Bodies:
        """Return the bodies; pairs are of two planned arms, or of a planned arm and another arm or an obstacle."""
        movers, still = (*arms.values(), *others.values()), stacked(obstacles)
        owners = tuple(name for name in (*arms, *others) for _ in SOLIDS)
        names = (*(f"{name} {solid}" for name in (*arms, *others) for solid in SOLIDS), *obstacles)
        radii = [solid_radii_m(arm.model) for arm in movers]
        groups = [range(len(SOLIDS) * k, len(SOLIDS) * (k + 1)) for k in range(len(movers))]
        groups += [range(k, k + 1) for k in range(len(owners), len(names))]
        meeting = (pair for pair in combinations(range(len(groups)), 2) if pair[0] < len(arms))
        pairs = [both for a, b in meeting for both in product(groups[a], groups[b])]
        radii_m = np.concatenate([*radii, still.radii_m])
        return cls(movers, still, names, radii_m, np.array(pairs, dtype=np.intp).reshape(-1, 2), owners)

    def arms_of(self, pair: NDArray[np.intp]) -> tuple[str, ...]:
        """Return the names of the arms to which two bodies belong."""
        return tuple(self.owners[body] for body in pair if body < len(self.owners))

    def ends_m(self, t_s: Array) -> Array:
        """Return both ends of every capsule in the world at the times (n,): (n, bodies, 2, 3) m."""
        still = np.broadcast_to(self.still.ends_m, (len(t_s), *self.still.ends_m.shape))
        return np.concatenate([*(arm.ends_m(t_s) for arm in self.movers), still], axis=1)

    def accelerations(self, begin_s: Array, end_s: Array) -> Array:
        """Return bounds on the acceleration of every point of every capsule over intervals: (n, bodies) m/s^2."""
        still = np.zeros((len(begin_s), len(self.still.radii_m)))
        return np.concatenate([*(greatest_accelerations(arm, begin_s, end_s) for arm in self.movers), still], axis=1)


def greatest_accelerations(arm: MovingArm, begin_s: Array, end_s: Array) -> Array:
    """Return bounds on the acceleration of every point of the instrument's capsules: (n, 4) m/s^2.

    Over an interval of length h between two samples, a point is never further than ``h^2 / 8`` times this from the
    straight line between its sampled positions, so nothing is hidden between samples.

    With ``l_k`` the greatest distance of the point from the axis of joint k (1 for the joint that slides), each
    joint adds ``l_k (|a_k| + |v_k| (|v_k| + 2 sum of |v_j| over the joints j before it))``, where only revolute joints
    count among the velocities in brackets, because they rotate the motion of the joints after them.

    Args:
        arm: on its trajectory.
        begin_s: (n,) starts of the intervals; none holds a knot of the trajectory inside.
        end_s: (n,) their ends.
    """
    if arm.rests:
        return np.zeros((len(begin_s), len(SOLIDS)))
    middle, half = (begin_s + end_s) / 2, (end_s - begin_s)[:, None] / 2
    speed, push = _greatest_rates(arm, middle, half)
    turning = speed.copy()
    turning[:, INSERTION] = 0.0
    before = np.cumsum(turning, axis=1) - turning
    depth = np.abs(wrist_depth_m(arm.model, arm.joints(middle)))
    levers = _levers(arm.model, depth, speed[:, INSERTION] * half[:, 0])
    return np.einsum("nkj,nj->nk", levers, push + speed * (turning + 2 * before))


def greatest_displacement_m(arm: MovingArm, q: Array) -> float:
    """Return a bound on how far any point of the capsules' axes is, at any time, from its place at joints ``q`` (6,).

    Turned from ``q`` one after the other, each joint takes a point along an arc: its angle times the distance from the
    joint's axis, for which ``_levers`` gives a bound.
    """
    off = np.abs(hulls(arm.trajectory, 0) - q).max(axis=(0, 1))
    depth = np.abs(wrist_depth_m(arm.model, q[None]))
    return float((_levers(arm.model, depth, off[INSERTION, None])[0] @ off).max())


def _greatest_rates(arm: MovingArm, middle_s: Array, half_s: Array) -> tuple[Array, Array]:
    """Return bounds (n, 6) of the joints' speeds and accelerations over intervals.

    Between two knots a trajectory is a polynomial, so its Taylor series about the middle ends at its degree.
    """
    orders = [np.abs(arm.joints(middle_s, order)) for order in range(1, len(arm.trajectory.coefficients))]
    factors = [half_s**k / factorial(k) for k in range(len(orders))]
    still = np.zeros((len(middle_s), len(arm.model.joints)))
    speed = sum((f * order for f, order in zip(factors, orders, strict=True)), still)
    push = sum((f * order for f, order in zip(factors, orders[1:], strict=False)), still)
    return speed, push


def _levers(arm: ArmModel, depth_m: Array, slid_m: Array) -> Array:
    """Return the greatest distances (n, 4, 6) of the capsules' points from the joints' axes over intervals.

    The axes of yaw, pitch and roll pass through the remote centre, and the shaft lies on the axis of the roll. The
    wrist is ``depth_m`` (n,) beyond the remote centre in the middle, and the insertion moves by up to ``slid_m`` (n,).
    """
    wrist, finger = arm.wrist_length_m, arm.instrument.finger_length_m
    lower = depth_m + slid_m
    upper = np.abs(arm.instrument.shaft_length_m - depth_m) + slid_m
    levers = np.zeros((len(depth_m), len(SOLIDS), len(arm.joints)))
    levers[:, :, INSERTION] = 1.0
    for k, reach_m in enumerate((0.0, wrist, wrist + finger, wrist + finger)):  # from the wrist's pitch axis
        levers[:, k, :INSERTION] = (np.maximum(lower, upper) if k == 0 else lower + reach_m)[:, None]
        levers[:, k, 3:5] = reach_m
    levers[:, 2:, 5] = finger
    return levers
