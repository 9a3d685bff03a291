"""A motion planning problem: what each arm must do, and what the arms must keep clear of, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import inf, pi

import numpy as np

from trocar.arms import ArmModel, MotionLimits, ik
from trocar.checks import decimals, outside
from trocar.errors import AlreadyThere, InvalidInput, OutOfReach, TrocarError
from trocar.geometry import SE3, direction, shown
from trocar.geometry.arrays import Array, finite, numbers
from trocar.geometry.se3 import one_pose
from trocar.motion.bodies import MovingArm, Obstacle
from trocar.motion.limits import KEPT

JOINTS = 6
NEAREST = 1e-9  # waypoints closer than this in every joint (rad, m) are the same
SAME_PLACE_M = 1e-3  # remote centres closer than this mean that the arms' bases were not given


@dataclass(frozen=True, eq=False)
class Facing:
    """An axis of the tip that stays turned towards a point: marks on a gripper that a camera must keep seeing.

    >>> facing = Facing(axis=[0.0, 1.0, 0.0], towards_m=[-0.05, 0.14, 0.07], max_rad=0.8)  # the jaws' axis, the camera

    Attributes:
        axis: (3,) in the frame of the tip, of any length; a unit vector afterwards.
        towards_m: (3,) in the world, the camera.
        max_rad: the angle between the axis and the direction from the tip to that point stays below this.
    """

    axis: Array
    towards_m: Array
    max_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "towards_m", finite("'towards_m' of what a tip faces", self.towards_m, 3))
        if not 0 < self.max_rad <= pi:
            raise InvalidInput("a tip", f"may face {self.max_rad} rad aside", "give an angle above 0, up to pi")
        object.__setattr__(self, "axis", direction(self.axis, "the axis that faces a point"))

    def angle_rad(self, T_world_tip: SE3) -> Array:
        """Return the angle (...,) between the axis and the direction to the point, for poses (...,) of the tip."""
        axis = T_world_tip.matrix[..., :3, :3] @ self.axis
        way = self.towards_m - T_world_tip.matrix[..., :3, 3]
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        return 2 * np.arctan2(np.linalg.norm(axis - way, axis=-1), np.linalg.norm(axis + way, axis=-1))


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """What one arm is asked to do: where to start, what to pass, where to stop, within which limits.

    >>> arm, limits = ARMS["psm-classic"], MOTION_LIMITS["paper"]
    >>> motion = ArmMotion(arm, waypoints, limits)  # (n, 6): grasp, lifted, over the target, lowered
    >>> motion = ArmMotion(arm, q_now[None], limits, T_base_goals=T_base_tips)  # poses of the tip instead

    Attributes:
        model: of the arm.
        waypoints: (n, 6) joints, rad and m; it starts at the first and rests at the last.
        limits: bounds of velocity and acceleration, and optionally of jerk.
        T_world_base: pose of its base; needed if arms or obstacles can meet.
        up: (3,) direction in its base, of any length, along which the tip passes the waypoints between the first
            and the last without turning; a unit vector afterwards. Planners that stop there may ignore it.
        fixed_wrist: whether the wrist joints stand still while the arm passes these waypoints, so that the tip turns a
            little. Planners that keep the tip on a straight line still turn the wrist by milliradians.
        straight: for each piece between two waypoints, whether the tip keeps to the straight line between
            them, turning as little as possible; empty: nowhere.
        start_velocity: (6,) of the joints at the first waypoint, per second: 0 at rest, another value to replace a
            running motion.
        T_base_goals: batch (m,) of poses of the tip in its base, to go through after the waypoints. Before planning
            they become waypoints: the inverse kinematics nearest to the previous waypoint.
        jaw_rad: opening between its fingers.
        max_tip_m_s: greatest speed of the tip, m/s.
        facing: axis of the tip that must stay turned towards a point, such as marks towards a camera; None: none.
    """

    model: ArmModel
    waypoints: Array
    limits: MotionLimits
    T_world_base: SE3 = field(default_factory=SE3.identity)
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    fixed_wrist: bool = False
    straight: tuple[bool, ...] = ()
    start_velocity: Array = field(default_factory=lambda: np.zeros(JOINTS))
    T_base_goals: SE3 | None = None
    jaw_rad: float = 0.0
    max_tip_m_s: float = inf
    facing: Facing | None = None

    def __post_init__(self) -> None:
        if self.T_base_goals is not None:
            object.__setattr__(self, "T_base_goals", SE3.of(self.T_base_goals))
        object.__setattr__(self, "T_world_base", one_pose(f"T_world_base of {self.model.name}", self.T_world_base))
        goals, name = self._goals, self.model.name
        points = numbers(f"the waypoints of {name}", self.waypoints, "n", JOINTS)
        if points.ndim != 2 or points.shape[1] != JOINTS or len(points) < 1 or len(points) + goals < 2:
            wanted = f"waypoints of shape (n, {JOINTS}) with n of 2 or more, or of 1 and goals"
            raise InvalidInput(name, f"needs {wanted}, got {points.shape} and {goals} goals")
        if not isinstance(self.limits, MotionLimits):
            got = type(self.limits).__name__
            raise InvalidInput(name, f"needs its limits as MotionLimits(velocity, acceleration), got {got}")
        if self.limits.velocity.shape != (JOINTS,):
            raise InvalidInput(name, f"needs limits of {JOINTS} joints, got {self.limits.velocity.size}")
        pieces = len(points) + goals - 1
        straight = tuple(bool(piece) for piece in self.straight) or (False,) * pieces
        if len(straight) != pieces:
            said = f"but {len(straight)} times it was said whether a piece is straight"
            raise InvalidInput(f"{pieces + 1} waypoints", f"have {pieces} pieces between them, {said}")
        object.__setattr__(self, "waypoints", points)
        object.__setattr__(self, "straight", straight)
        object.__setattr__(self, "up", direction(self.up, "the upward direction"))
        object.__setattr__(self, "start_velocity", self._checked_velocity())
        self._require_apart()
        if not np.isfinite(self.jaw_rad):
            raise InvalidInput("the jaws", f"of {name} open {self.jaw_rad} rad", "give a finite number")
        if not self.max_tip_m_s > 0:
            raise InvalidInput("the tip", f"of {name} may move at {self.max_tip_m_s} m/s", "give a speed above 0")

    def __repr__(self) -> str:
        goals = "" if self.T_base_goals is None else f" and {self._goals} goals"
        return f"<ArmMotion of {self.model.name} through {len(self.waypoints)} waypoints{goals}>"

    @property
    def moves(self) -> bool:
        """Return whether the arm is moving at the start."""
        return bool(self.start_velocity.any())

    def resolved(self) -> ArmMotion:
        """Return the motion with its goals turned into waypoints (OutOfReach; AlreadyThere: two coincide)."""
        if self.T_base_goals is None:
            return self
        points = list(self.waypoints)
        for index in range(self._goals):
            try:
                points.append(ik(self.model, self.T_base_goals[index], points[-1]))
            except OutOfReach as error:
                raise error.worded(f"goal {index}: {error}") from None
        return replace(self, waypoints=np.array(points), T_base_goals=None)

    def require_ranges(self, slack: float) -> None:
        """Raise unless the waypoints lie within the joints' ranges, widened by the share ``slack``."""
        for index, point in enumerate(self.waypoints):
            for joint, value in zip(self.model.joints, point, strict=True):
                beyond = slack * (joint.upper - joint.lower)
                if not joint.lower - beyond <= value <= joint.upper + beyond:
                    shown, ends = outside(float(value), joint.lower, joint.upper)
                    where = f"waypoint {index}, joint '{joint.name}' = {shown} {joint.unit}"
                    problem = f"is outside {ends} {joint.unit} of {self.model.name}"
                    raise InvalidInput(where, problem, "move it inside")

    @property
    def _goals(self) -> int:
        if self.T_base_goals is None:
            return 0
        shape = self.T_base_goals.matrix.shape
        if len(shape) != 3:
            raise InvalidInput("goals", f"are poses (m, 4, 4), got {shape}", "index one as [None]")
        return shape[0]

    def _checked_velocity(self) -> Array:
        velocity = finite(f"the start velocity of {self.model.name}", self.start_velocity, JOINTS)
        for joint, value, most in zip(self.model.joints, velocity, self.limits.velocity, strict=True):
            if abs(value) > KEPT * most:
                n = decimals(abs(value), most)
                problem = f"starts with {value:.{n}f} {joint.unit}/s, beyond its limit of {most:.{n}f}"
                raise InvalidInput(f"joint '{joint.name}'", problem, "raise the limit or slow down first")
        return velocity

    def _require_apart(self) -> None:
        points = self.waypoints
        for index, at in np.argwhere(~np.isfinite(points)).tolist():
            where = f"waypoint {index}, joint '{self.model.joints[at].name}'"
            raise InvalidInput(where, f"is {points[index, at]}", "give a finite number")
        same = np.all(np.abs(np.diff(points, axis=0)) < NEAREST, axis=1)
        if self.moves and len(same):
            same[0] = False  # stopping and coming back is a motion too
        if same.any():
            first = int(np.flatnonzero(same)[0])
            raise AlreadyThere(f"waypoints {first} and {first + 1} coincide; remove one of them")


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """A motion planning problem, for one arm or several that start together.

    >>> table = HalfSpace(point_m=[0.0, 0.0, -0.01], normal=[0.0, 0.0, 1.0])
    >>> problem = MotionProblem({"psm1": left, "psm2": right}, obstacles={"table": table}, min_distance_m=1e-3)

    Attributes:
        arms: what each arm is asked to do, by name.
        others: arms that are not planned, by name: they rest or follow a known trajectory. Time 0 is the start of the
            plan, so an arm that is already moving has a ``start_s`` below 0.
        obstacles: fixed things in the world, by name.
        min_distance_m: distance to keep between the parts of different arms, and to obstacles.
        range_slack: share of its range by which a joint may exceed it, for recordings of arms whose real range is
            wider than the nominal one.
        straight_tolerance_m: how far the tip may be off a straight piece.
        straight_tolerance_rad: how far its rotation there may differ from the shortest one between the piece's ends.
    """

    arms: Mapping[str, ArmMotion]
    others: Mapping[str, MovingArm] = field(default_factory=dict)
    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)
    min_distance_m: float = 0.0
    range_slack: float = 0.0
    straight_tolerance_m: float = 1e-4
    straight_tolerance_rad: float = 1e-3

    def __post_init__(self) -> None:
        if not self.arms:
            raise InvalidInput("a motion problem", "needs at least one arm", "give what each is asked by its name")
        kinds = {"arms": ArmMotion, "others": MovingArm, "obstacles": Obstacle}
        for what, kind in kinds.items():
            things = getattr(self, what)
            if not (isinstance(things, Mapping) and all(isinstance(thing, kind) for thing in things.values())):
                wanted = getattr(kind, "__name__", "Capsule or HalfSpace")
                raise InvalidInput(what, f"of a motion problem are {things!r:.60}", f"give {wanted} by name")
        for name in ("min_distance_m", "range_slack", "straight_tolerance_m", "straight_tolerance_rad"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInput(name, f"of a motion problem is {value}", "give a finite number of at least 0")
        names = [*self.arms, *self.others, *self.obstacles]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidInput("two things", f"are called {', '.join(twice)}", "give arms and obstacles distinct names")
        for name, arm in self.arms.items():
            try:
                arm.require_ranges(self.range_slack)
            except TrocarError as error:
                raise (error if len(self.arms) == 1 else error.worded(f"arm '{name}': {error}")) from None
        centers = {name: arm.T_world_base.translation_m for name, arm in (*self.arms.items(), *self.others.items())}
        for a, b in combinations(centers, 2):
            if np.linalg.norm(centers[a] - centers[b]) < SAME_PLACE_M:
                raise InvalidInput(f"arms '{a}' and '{b}'", "share one remote centre", "give each its own T_world_base")

    def __repr__(self) -> str:
        parts = [f"{name}: {arm!r}" for name, arm in self.arms.items()]
        around = [*self.others, *self.obstacles]
        if around:
            parts.append(f"{shown(self.min_distance_m, 'm', 'g')} from {', '.join(around)}")
        return f"<MotionProblem {'; '.join(parts)}>"

    def resolved(self) -> MotionProblem:
        """Return the problem with all goals turned into waypoints, as planners get it; errors name the arm."""
        arms = {}
        for name, arm in self.arms.items():
            try:
                arms[name] = arm.resolved()
            except (OutOfReach, AlreadyThere) as error:
                error.arm = name
                raise error.worded(f"arm '{name}', {error}") from None
        return replace(self, arms=arms)
