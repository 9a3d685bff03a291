"""A motion planning problem, for one arm or several on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from trocar.errors import AlreadyThere, InvalidInput, OutOfReach, TrocarError
from trocar.geometry import shown
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.moving_arm import MovingArm
from trocar.motion.obstacles import Obstacle

SETTINGS = (
    "min_distance_m",
    "range_slack",
    "straight_tolerance_m",
    "straight_tolerance_rad",
)
SAME_PLACE_M = 1e-3
"""Remote centres closer than this mean that the arms' bases were not given."""


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """A motion planning problem, for one arm or several that start together.

    >>> table = HalfSpace(point_m=[0.0, 0.0, -0.01], normal=[0.0, 0.0, 1.0])
    >>> problem = MotionProblem({"psm1": left, "psm2": right}, obstacles={"table": table}, min_distance_m=1e-3)

    Attributes:
        arms: what each arm is asked to do, by name.
        others: arms that are not planned, by name: they rest or follow a known trajectory. Their clock starts with
            the plan's, so that one that is already running has a ``start_s`` below 0.
        obstacles: fixed things in the world, by name.
        min_distance_m: to keep between the parts of different arms, and to obstacles.
        range_slack: share of each joint's range by which it may be left, for recordings of arms whose real
            range is wider than the nominal one.
        straight_tolerance_m: how far the tip may be off a straight piece.
        straight_tolerance_rad: how far it may be turned there from the shortest turn between its ends.
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
        for what, things, kind in (
            ("arms", self.arms, ArmMotion),
            ("others", self.others, MovingArm),
            ("obstacles", self.obstacles, Obstacle),
        ):
            if not (isinstance(things, Mapping) and all(isinstance(thing, kind) for thing in things.values())):
                wanted = getattr(kind, "__name__", "Capsule or HalfSpace")
                raise InvalidInput(what, f"of a motion problem are {things!r:.60}", f"give {wanted} by name")
        for name in SETTINGS:
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
        self._require_bases_apart()

    def __repr__(self) -> str:
        parts = [f"{name}: {arm!r}" for name, arm in self.arms.items()]
        around = [*self.others, *self.obstacles]
        if around:
            parts.append(f"{shown(self.min_distance_m, 'm', 'g')} from {', '.join(around)}")
        return f"<MotionProblem {'; '.join(parts)}>"

    def _require_bases_apart(self) -> None:
        centers = {name: arm.T_world_base.translation_m for name, arm in (*self.arms.items(), *self.others.items())}
        for a, b in combinations(centers, 2):
            if np.linalg.norm(centers[a] - centers[b]) < SAME_PLACE_M:
                raise InvalidInput(f"arms '{a}' and '{b}'", "share one remote centre", "give each its own T_world_base")

    def resolved(self) -> MotionProblem:
        """Return the same with all goals as waypoints, as planners get it.

        Raises:
            OutOfReach: a goal is out of reach; names the arm.
            AlreadyThere: a goal is where an arm already is; names the arm.
        """
        arms = {}
        for name, arm in self.arms.items():
            try:
                arms[name] = arm.resolved()
            except (OutOfReach, AlreadyThere) as error:
                error.arm = name
                raise error.worded(f"arm '{name}', {error}") from None
        return replace(self, arms=arms)
