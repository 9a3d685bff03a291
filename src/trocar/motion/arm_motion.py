"""The motion asked of one arm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits, ik
from trocar.errors import AlreadyThere, InvalidInput, OutOfReach
from trocar.geometry import SE3, direction
from trocar.geometry.arrays import finite, numbers
from trocar.geometry.se3 import one_pose
from trocar.motion.facing import Facing
from trocar.motion.limits import KEPT

NEAREST = 1e-9
"""Waypoints closer than this in every joint (rad, m) are the same."""

JOINTS = 6


def _still() -> NDArray[np.float64]:
    return np.zeros(JOINTS)


def _up() -> NDArray[np.float64]:
    return np.array([0.0, 0.0, 1.0])


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
        fixed_wrist: whether the wrist's joints rest when it passes these waypoints, so that the tip turns a little;
            planners that keep the tip on a straight line turn the wrist by milliradians.
        straight: for each piece between two waypoints, whether the tip keeps to the straight line between
            them, turning as little as possible; empty: nowhere.
        start_velocity: (6,) of the joints at the first waypoint, per second; 0 at rest. A motion that replaces
            another one under way starts moving.
        T_base_goals: batch (m,) of poses of the tip in its base, to go through after the waypoints. Before the
            planner is asked they become waypoints, by the inverse kinematics nearest to the one before.
        jaw_rad: opening between its fingers.
        max_tip_m_s: greatest speed of the tip, m/s.
        facing: what the tip must keep turned towards a point, the marks that a camera sees; None: nothing.
    """

    model: ArmModel
    waypoints: NDArray[np.float64]
    limits: MotionLimits
    T_world_base: SE3 = field(default_factory=SE3.identity)
    up: NDArray[np.float64] = field(default_factory=_up)
    fixed_wrist: bool = False
    straight: tuple[bool, ...] = ()
    start_velocity: NDArray[np.float64] = field(default_factory=_still)
    T_base_goals: SE3 | None = None
    jaw_rad: float = 0.0
    max_tip_m_s: float = inf
    facing: Facing | None = None

    def __post_init__(self) -> None:
        if self.T_base_goals is not None:
            object.__setattr__(self, "T_base_goals", SE3.of(self.T_base_goals))
        object.__setattr__(self, "T_world_base", one_pose(f"T_world_base of {self.model.name}", self.T_world_base))
        goals = 0 if self.T_base_goals is None else _count(self.T_base_goals)
        points = numbers(f"the waypoints of {self.model.name}", self.waypoints, "n", JOINTS)
        if points.ndim != 2 or points.shape[1] != JOINTS or len(points) < 1 or len(points) + goals < 2:
            raise InvalidInput(
                self.model.name,
                f"needs waypoints of shape (n, {JOINTS}) with n of 2 or more, or of 1 and goals, "
                f"got {points.shape} and {goals} goals",
            )
        if not isinstance(self.limits, MotionLimits):
            raise InvalidInput(
                self.model.name,
                f"needs its limits as MotionLimits(velocity, acceleration), got {type(self.limits).__name__}",
            )
        if self.limits.velocity.shape != (JOINTS,):
            raise InvalidInput(self.model.name, f"needs limits of {JOINTS} joints, got {self.limits.velocity.size}")
        straight = tuple(bool(piece) for piece in self.straight) or (False,) * (len(points) + goals - 1)
        if len(straight) != len(points) + goals - 1:
            raise InvalidInput(
                f"{len(points) + goals} waypoints",
                f"have {len(points) + goals - 1} pieces between them, "
                f"but {len(straight)} times it was said whether a piece is straight",
            )
        object.__setattr__(self, "waypoints", points)
        object.__setattr__(self, "straight", straight)
        object.__setattr__(self, "up", direction(self.up, "the upward direction"))
        object.__setattr__(self, "start_velocity", self._checked_velocity())
        self._require_apart()
        if not np.isfinite(self.jaw_rad):
            raise InvalidInput("the jaws", f"of {self.model.name} open {self.jaw_rad} rad", "give a finite number")
        if not self.max_tip_m_s > 0:
            raise InvalidInput(
                "the tip", f"of {self.model.name} may move at {self.max_tip_m_s} m/s", "give a speed above 0"
            )

    def __repr__(self) -> str:
        goals = "" if self.T_base_goals is None else f" and {_count(self.T_base_goals)} goals"
        return f"<ArmMotion of {self.model.name} through {len(self.waypoints)} waypoints{goals}>"

    @property
    def moves(self) -> bool:
        """Return whether it is moving at the start."""
        return bool(self.start_velocity.any())

    def resolved(self) -> ArmMotion:
        """Return the same with its goals as waypoints.

        Raises:
            OutOfReach: a goal is out of reach.
            AlreadyThere: two goals coincide, or the first with where it is.
        """
        if self.T_base_goals is None:
            return self
        points = list(self.waypoints)
        for index in range(_count(self.T_base_goals)):
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
                    raise InvalidInput(
                        f"waypoint {index}, joint '{joint.name}' = {value:.4f} {joint.unit}",
                        f"is outside [{joint.lower:.4f}, {joint.upper:.4f}] {joint.unit} of {self.model.name}",
                        "move it inside",
                    )

    def _checked_velocity(self) -> NDArray[np.float64]:
        velocity = finite(f"the start velocity of {self.model.name}", self.start_velocity, JOINTS)
        for joint, value, most in zip(self.model.joints, velocity, self.limits.velocity, strict=True):
            if abs(value) > KEPT * most:
                raise InvalidInput(
                    f"joint '{joint.name}'",
                    f"starts with {value:.4f} {joint.unit}/s, beyond its limit of {most:.4f}",
                    "raise the limit or slow down first",
                )
        return velocity

    def _require_apart(self) -> None:
        points = self.waypoints
        for index, point in enumerate(points):
            for joint, value in zip(self.model.joints, point, strict=True):
                if not np.isfinite(value):
                    raise InvalidInput(f"waypoint {index}, joint '{joint.name}'", f"is {value}", "give a finite number")
        same = np.all(np.abs(np.diff(points, axis=0)) < NEAREST, axis=1)
        if self.moves and len(same):
            same[0] = False  # stopping and coming back is a motion too
        if same.any():
            first = int(np.flatnonzero(same)[0])
            raise AlreadyThere(f"waypoints {first} and {first + 1} coincide; remove one of them")


def _count(T_base_goals: SE3) -> int:
    """Return how many goals there are, or raise."""
    if T_base_goals.matrix.ndim != 3:
        raise InvalidInput("goals", f"are poses (m, 4, 4), got {T_base_goals.matrix.shape}", "index one as [None]")
    return len(T_base_goals.matrix)
