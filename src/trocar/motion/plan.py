"""Motion plans: answers of planners, checked."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, nan

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import AlreadyThere, InvalidInput, MotionRefused, NoPlan, OutOfReach, TrocarError
from trocar.geometry.arrays import Array, finite, numbers
from trocar.motion.check import Violation, check
from trocar.motion.clearance import Clearance
from trocar.motion.double_integrator import duration_bound_s
from trocar.motion.limits import LimitUse
from trocar.motion.planners import PLANNERS, Demand, Planner, TimedPath
from trocar.motion.problem import ArmMotion, MotionProblem
from trocar.notebook import table
from trocar.trajectory import Trajectory

NO_CLEARANCE = Clearance(inf, inf, 0.0, ("", ""))


@dataclass(frozen=True, eq=False, repr=False)
class MotionPlan:
    """The answer of a planner, and the result of the check.

    Attributes:
        planner: name of the planner.
        paths: by arm, as the planner returned them; kept even if the check rejects them, for inspection.
        bound_s: no motion through the same waypoints is shorter (``duration_bound_s``).
        compute_ms: time that planner and check took.
        use: by arm, what the paths use of the limits.
        clearance: how close arms and obstacles come; only as precise as needed to decide whether the least distance is
            kept.
        violations: the requirements that are violated.
        refusal: why there is no valid plan, as a typed error; None if there is one.
    """

    planner: str
    paths: Mapping[str, TimedPath]
    bound_s: float
    compute_ms: float
    use: Mapping[str, LimitUse] = field(default_factory=dict)
    clearance: Clearance = NO_CLEARANCE
    violations: tuple[Violation, ...] = ()
    refusal: MotionRefused | None = None

    def __repr__(self) -> str:
        if not self.found:
            return f"<no MotionPlan: {self.reason}>"
        return f"<MotionPlan of {', '.join(self.paths)} by '{self.planner}': {self.duration_s:.3f} s>"

    def _repr_html_(self) -> str:
        columns = ("arm", "time, s", "waypoints", "share of velocity limits", "share of acceleration limits")
        rows = []
        for name, path in self.paths.items():
            use = self.use.get(name)
            shares = ("", "") if use is None else (f"{use.velocity_ratio:.2f}", f"{use.acceleration_ratio:.2f}")
            rows.append((name, f"{path.trajectory.duration_s:.3f}", len(path.waypoint_times_s), *shares))
        return table(self, columns, rows)

    @property
    def found(self) -> bool:
        """Return whether the motion meets all requirements."""
        return self.refusal is None

    @property
    def reason(self) -> str:
        """Return why there is no valid plan, in a sentence; empty if there is one."""
        return "" if self.refusal is None else str(self.refusal)

    @property
    def duration_s(self) -> float:
        """Return the time until the last arm rests; NaN if the planner returned nothing."""
        return max((path.trajectory.duration_s for path in self.paths.values()), default=nan)

    @property
    def trajectories(self) -> Mapping[str, Trajectory]:
        """Return the valid motions of all arms, which start together; or raise the plan's refusal."""
        if self.refusal is not None:
            raise self.refusal
        return {name: path.trajectory for name, path in self.paths.items()}

    @property
    def trajectory(self) -> Trajectory:
        """Return the valid motion of the only arm; or raise the plan's refusal, or InvalidInput if several move."""
        trajectories = self.trajectories
        if len(trajectories) > 1:
            raise InvalidInput("this plan", f"moves {', '.join(trajectories)}", "take one of its `trajectories`")
        return next(iter(trajectories.values()))

    @property
    def waypoint_times_s(self) -> Mapping[str, Array]:
        """Return when each arm passes its waypoints, (n,) each."""
        return {name: path.waypoint_times_s for name, path in self.paths.items()}


def plan_motion(problem: MotionProblem, planner: str | Planner = "spline") -> MotionPlan:
    """Return the planner's answer to a problem, checked independently of the planner.

    >>> plan = plan_motion(MotionProblem({"psm1": ArmMotion(arm, waypoints, limits)}), planner="spline")
    >>> plan.found
    True
    >>> motion = plan.trajectories["psm1"]
    >>> q = motion(0.5)  # (6,) joints after half a second

    Args:
        problem: the problem.
        planner: name in ``PLANNERS``, or a planner.

    Raises:
        TrocarError: an unknown planner, or a malformed answer. Other failures do not raise: if there is no motion, none
            is needed, or none meets the requirements, the plan is not ``found``, and its ``refusal`` tells why.
    """
    solve = PLANNERS.pick(planner) if isinstance(planner, str) else planner
    name = planner if isinstance(planner, str) else getattr(planner, "__name__", type(planner).__name__)
    begin = time.perf_counter()
    try:
        problem = problem.resolved()
    except (OutOfReach, AlreadyThere) as error:
        return MotionPlan(name, {}, nan, _ms_since(begin), refusal=error)
    bound_s = max(duration_bound_s(arm.waypoints, arm.limits, arm.start_velocity) for arm in problem.arms.values())
    try:
        paths = solve(problem)
    except TrocarError as error:
        sentence = f"planner '{name}' found no motion: {error}"
        refusal = error.worded(sentence) if isinstance(error, MotionRefused) else NoPlan(sentence, planner=name)
        return MotionPlan(name, {}, bound_s, _ms_since(begin), refusal=refusal)
    paths = _answered(name, problem, paths)
    found = check(problem, paths)
    refusal = _refusal(name, solve, found.violations)
    return MotionPlan(name, paths, bound_s, _ms_since(begin), found.use, found.clearance, found.violations, refusal)


def plan_through(
    model: ArmModel,
    waypoints: ArrayLike,
    limits: MotionLimits,
    *,
    up: ArrayLike = (0.0, 0.0, 1.0),
    fixed_wrist: bool = False,
    start_velocity: ArrayLike | None = None,
    planner: str | Planner = "spline",
    range_slack: float = 0.0,
) -> MotionPlan:
    """Return the plan of one arm through waypoints with nothing in its way: ``plan_motion`` in one line.

    Two waypoints: a plain move. Three: approach from above (start, above, down) or retreat (grasp, above, away).
    Four: a transfer (grasp, lifted, over the target, lowered).

    >>> motion = plan_through(arm, waypoints, limits).trajectory  # or a TrocarError that says why there is none
    >>> waypoints[-1].round(2) == motion(motion.duration_s).round(2)
    array([ True,  True,  True,  True,  True,  True])

    Args:
        model: the arm that moves.
        waypoints: (n, 6) joints with n >= 2, rad and m.
        limits: bounds of velocity and acceleration.
        up: (3,) direction in the arm's base along which inner waypoints are passed.
        fixed_wrist: whether the wrist joints stand still there; else the tip does not turn.
        start_velocity: (6,) at the first waypoint; None: at rest.
        planner: name in ``PLANNERS``, or a planner.
        range_slack: share of its range by which a joint may exceed it.
    """
    points = numbers("the waypoints", waypoints, "n", len(model.joints))
    start = finite("the start velocity", np.zeros(6) if start_velocity is None else start_velocity, 6)
    upwards = finite("the upward direction", up, 3)
    motion = ArmMotion(model, points, limits, up=upwards, fixed_wrist=fixed_wrist, start_velocity=start)
    return plan_motion(MotionProblem({model.name: motion}, range_slack=range_slack), planner)


def _answered(name: str, problem: MotionProblem, paths: object) -> dict[str, TimedPath]:
    """Return a planner's answer (InvalidInput, which names the planner: the answer is malformed)."""
    who = f"planner '{name}'"
    if not (isinstance(paths, Mapping) and all(isinstance(path, TimedPath) for path in paths.values())):
        raise InvalidInput(who, f"returned {paths!r:.80}", "it must return a TimedPath for each arm by name")
    if set(paths) != set(problem.arms):
        raise InvalidInput(who, f"returned paths for {sorted(paths)}", f"it was asked for {sorted(problem.arms)}")
    return dict(paths)


def _refusal(name: str, solve: Planner, violations: Sequence[Violation]) -> MotionRefused | None:
    """Return why an answer is refused (None if it is not): the first violation, and what the planner ignores."""
    if not violations:
        return None
    more = f" (and {len(violations) - 1} more)" if len(violations) > 1 else ""
    sentence = f"the motion by planner '{name}' is refused: {violations[0]}{more}"
    ignored = getattr(solve, "ignores", frozenset())
    unseen = [demand.value for demand in Demand if demand in {v.demand for v in violations} & ignored]
    if unseen:
        others = [other for other in PLANNERS if other != name]
        sentence += f"; '{name}' ignores {', '.join(unseen)}" + f", try {', '.join(others)}" * bool(others)
    return violations[0].error.worded(sentence)


def _ms_since(begin: float) -> float:
    return 1e3 * (time.perf_counter() - begin)
