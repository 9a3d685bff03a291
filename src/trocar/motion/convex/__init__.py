"""The planner ``convex``: collision-free motions by sequential convex programs (Schulman et al. 2013)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.errors import ArmMoving, NoPlan, TooNear
from trocar.geometry import shown
from trocar.motion.convex.scene import SOLID_COUNT, Scene, columns_of, joint_path
from trocar.motion.convex.search import Search
from trocar.motion.planners import Demand, TimedPath, ignores
from trocar.motion.problem import MotionProblem

NEAR_M = 1e-9  # a distance at an end may fall short of the required one by this: rounding
ASIDE_RAD = 1e-9


@ignores(Demand.STRAIGHT, Demand.JERK)
def convex(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return a motion of all arms together that keeps all distances, by sequential convex programs.

    Schulman et al. 2013, as used by Kehoe et al. 2014: the path of all joints together, through the waypoints
    of every arm, is bent as little as necessary. Distances of all capsules are linearised about the previous path, and
    violations have a price (an l1 merit, a trust region); each step is a small quadratic program. The plain path
    is tried first, then detours. A path is certified between its samples too before it is returned, and timed as
    fast as the limits of joints and tips allow.

    Raises:
        ArmMoving: an arm is not at rest at the start.
        TooNear: "infeasible: ...": the start, the end or a waypoint is already too near to something.
        NoPlan: "infeasible: ...": at a waypoint, a tip does not face its point; "not found: ...": a motion may exist.
    """
    for name, arm in problem.arms.items():
        if arm.moves:
            raise ArmMoving(name, "'convex' plans from rest, let the arm rest first")
    scene = Scene.of(problem)
    search = Search(problem, scene)
    timing = search.plain()
    if timing is None:
        require_possible(problem, scene)
        timing = search.round_about()
    if timing is None:
        reason = "not found: no start led to a motion that keeps all distances; ask for less or elsewhere"
        raise NoPlan(reason, planner="convex")
    return {
        name: TimedPath(joint_path(timing.motion, k), timing.times_s(search.passing[k]))
        for k, name in enumerate(problem.arms)
    }


def require_possible(problem: MotionProblem, scene: Scene) -> None:
    """Raise if the start, the end or a waypoint already violates a requirement."""
    ends = np.stack([np.concatenate([arm.waypoints[i] for arm in scene.arms]) for i in (0, -1)])
    distances = scene.distances(ends, np.array([0.0, max((o.end_s for o in problem.others.values()), default=0.0)]))
    for place, where in enumerate(("start", "end")):
        short = distances.distance_m[place] - problem.min_distance_m
        if short.min(initial=0.0) < -NEAR_M:
            pair = int(np.argmin(short))
            distance_m = float(distances.distance_m[place, pair])
            raise _too_near(scene, scene.pairs[pair], where, distance_m, problem.min_distance_m)
    for k, (name, arm) in enumerate(problem.arms.items()):
        _require_waypoints_clear(scene, k, problem.min_distance_m)
        if arm.facing is None:
            continue
        angles = arm.facing.angle_rad(arm.T_world_base @ fk(arm.model, arm.waypoints))
        if angles.max() > arm.facing.max_rad + ASIDE_RAD:
            index = int(np.argmax(angles))
            faces = f"the tip of '{name}' faces {angles[index]:.3f} rad aside, not {arm.facing.max_rad:.3f}"
            reason = f"infeasible: at waypoint {index} {faces}; turn it towards the point"
            raise NoPlan(reason, planner="convex")


def _require_waypoints_clear(scene: Scene, k: int, min_distance_m: float) -> None:
    """Raise if an inner waypoint of an arm is too close to something that does not move."""
    arm = scene.arms[k]
    if len(arm.waypoints) == 2:
        return
    moving = SOLID_COUNT * len(scene.bodies.movers)
    own = (scene.pairs[:, 0] // SOLID_COUNT == k) & (scene.pairs[:, 1] >= moving)
    joints = np.concatenate([other.waypoints[0] for other in scene.arms])
    q = np.tile(joints, (len(arm.waypoints) - 2, 1))
    q[:, columns_of(k)] = arm.waypoints[1:-1]
    distances = scene.looking_at(own).distances(q, np.zeros(len(q))).distance_m
    if distances.size and distances.min() < min_distance_m - NEAR_M:
        index, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
        distance_m = float(distances[index, pair])
        raise _too_near(scene, scene.pairs[own][pair], f"waypoint {index + 1}", distance_m, min_distance_m)


def _too_near(scene: Scene, pair: NDArray[np.intp], where: str, distance_m: float, required_m: float) -> TooNear:
    """Return the refusal of two bodies that are too near at the start, the end or a waypoint."""
    a, b = (scene.bodies.names[body] for body in pair)
    place = where if where.startswith("waypoint") else f"the {where}"
    near, wanted = (shown(value, "m", ".2f") for value in (distance_m, required_m))
    sentence = f"infeasible: at {place}, {a} is {near} from {b}, not {wanted}; move {place}"
    arms, at_start = scene.bodies.arms_of(pair), where == "start"
    return TooNear(
        sentence, first=a, second=b, distance_m=distance_m, required_m=required_m, arms=arms, at_start=at_start
    )
