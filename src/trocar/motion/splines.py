"""The planner ``spline``: cubics through the waypoints, passed along ``up`` (Hwang et al. 2022, section IV-C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import MotionLimits, jacobian
from trocar.errors import NoPlan
from trocar.geometry.arrays import Array
from trocar.motion.planners import Demand, TimedPath, ignores
from trocar.motion.problem import ArmMotion, MotionProblem
from trocar.trajectory import Trajectory

# As the authors ran it: these reproduce the durations that they recorded (tests/motion/test_splines.py).
STEP_RATE = 0.06  # beta of Algorithm 2
STEPS = 51
PROBE = 0.15  # half width of the central difference, rad/s along a unit direction in joint space
COST_FIRST_S, COST_STEP_S = 0.30, 0.02  # durations tried while descending
FINAL_STEP_S = 0.01  # durations tried in the end: the control period
LONGEST_S = 120.0


@ignores(Demand.STRAIGHT, Demand.DISTANCES, Demand.JERK, Demand.TIP_SPEED, Demand.FACING)
def spline(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return the cubic spline of each arm through its waypoints, planned separately.

    Hwang et al. 2022, section IV-C. It rests at the end and passes the inner waypoints along ``up`` (or against
    it: the sign of the speed is found too), so that a block leaves and enters its peg straight. The cost of a set of
    passing speeds is the sum of the shortest durations of the cubics on a grid; of the speeds visited, the cheapest are
    kept, because a descent on a stepped cost does not end at its best. The limits of velocity and acceleration are kept
    exactly: a cubic's extremes are known in closed form.
    """
    return {name: _spline(arm) for name, arm in problem.arms.items()}


def _spline(arm: ArmMotion) -> TimedPath:
    """Return one arm's spline."""
    waypoints, limits = arm.waypoints, arm.limits
    directions = _passing_directions(arm)
    speeds = _descend(arm, directions)
    velocities = _velocities(arm.start_velocity, speeds[None], directions)
    durations = _shortest(waypoints, velocities, limits, FINAL_STEP_S, FINAL_STEP_S)[0]
    times = np.concatenate([[0.0], np.cumsum(durations)])
    return TimedPath(Trajectory.hermite(times, waypoints, velocities[0]), times)


def _passing_directions(arm: ArmMotion) -> Array:
    """Return unit joint velocities (n - 2, joints) along ``up``, without turning the tip or with a still wrist."""
    inner = arm.waypoints[1:-1]
    if not len(inner):
        return np.zeros_like(inner)
    joints = 3 if arm.fixed_wrist else 6
    twist = np.concatenate([arm.up, np.zeros(3)])[:joints, None]
    directions = np.zeros_like(inner)
    try:
        moving = np.linalg.solve(
            jacobian(arm.model, inner)[:, :joints, :joints], np.broadcast_to(twist, (len(inner), joints, 1))
        )
    except np.linalg.LinAlgError:
        place = "at an inner waypoint, where it cannot pass straight; move the waypoint"
        raise NoPlan(f"{arm.model.name} is singular {place}") from None
    directions[:, :joints] = moving[..., 0]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _descend(arm: ArmMotion, directions: Array) -> Array:
    """Return the passing speeds (n - 2,) along the unit directions by Algorithm 2."""
    waypoints, limits, count = arm.waypoints, arm.limits, len(directions)
    if not count:
        return np.zeros(0)
    fastest = np.min(np.asarray(limits.velocity) / np.maximum(np.abs(directions), 1e-12), axis=1)
    probes = PROBE * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    speeds = np.zeros(count)
    stopping = _velocities(arm.start_velocity, speeds[None], directions)
    resting = _shortest(waypoints, stopping, limits, COST_FIRST_S, COST_STEP_S)
    steps = {"first_s": COST_FIRST_S, "step_s": COST_STEP_S, "longest_s": 1.3 * resting.max(), "batch": len(probes)}
    grid = CubicGrid.build(waypoints, limits, **steps)
    best, best_speeds = np.inf, speeds
    for _ in range(STEPS + 1):
        probed = np.maximum(np.minimum(speeds + probes, fastest), -fastest)
        velocities = _velocities(arm.start_velocity, probed, directions)
        costs = grid.shortest(velocities).sum(axis=1)
        if costs.max() == np.inf:
            costs = _shortest(waypoints, velocities, limits, COST_FIRST_S, COST_STEP_S).sum(axis=1)
        if costs[0] < best - 1e-9:
            best, best_speeds = costs[0], probed[0]
        gradient = (costs[1 : count + 1] - costs[count + 1 :]) / (2 * PROBE)
        speeds = speeds - STEP_RATE * gradient
    return best_speeds


def _velocities(start: Array, speeds: Array, directions: Array) -> Array:
    """Return velocities (batch, n, joints) at all waypoints, zero at the last, from speeds (batch, n - 2)."""
    velocities = np.zeros((len(speeds), len(directions) + 2, directions.shape[1]))
    velocities[:, 0] = start
    velocities[:, 1:-1] = speeds[..., None] * directions
    return velocities


@dataclass(frozen=True, eq=False)
class CubicGrid:
    """The durations ``first_s + k step_s`` on which cubics through fixed positions are tried.

    With ``s = 1 / t`` the accelerations of a cubic at its two ends are ``6 dq s^2 - (4 v0 + 2 v1) s`` and
    ``-6 dq s^2 + (2 v0 + 4 v1) s``. Multiplied by ``t``, the limit ``A`` reads ``6 dq s - A t <= c <= 6 dq
    s + A t`` with ``c = 4 v0 + 2 v1`` or ``2 v0 + 4 v1``: both bounds are known before the velocities are, so planning
    only has to compare.
    """

    times_s: Array  # (grid,) durations, ascending; the last is infinite and stands for "none on the grid"
    step_q: Array  # (segments, joints) positions' differences, rad or m
    limits: MotionLimits  # bounds of velocity and acceleration
    # (joints, batch, 2 segments, grid) least ``c`` that keeps the acceleration's limit, starts then ends; repeated
    # over the batch, because NumPy compares equal shapes twice as fast as broadcast ones
    lower: Array
    upper: Array  # the greatest
    sums: Array  # (3 segments, waypoints) takes velocities to ``4 v0 + 2 v1``, ``2 v0 + 4 v1`` and ``v0 + v1``

    @classmethod
    def build(
        cls, waypoints: Array, limits: MotionLimits, *, first_s: float, step_s: float, longest_s: float, batch: int
    ) -> CubicGrid:
        """Return the grid up to about ``longest_s`` for the segments between waypoints (n, joints)."""
        count = max(1, int(np.ceil((longest_s - first_s) / step_s)) + 1)
        times = np.append(first_s + step_s * np.arange(count), np.inf)
        step_q = np.diff(waypoints, axis=0)
        centre = np.ascontiguousarray(np.tile(6 * step_q, (batch, 2, 1)).transpose(2, 0, 1))[..., None] / times
        reach = limits.acceleration[:, None, None, None] * times
        start, end = np.eye(len(waypoints))[:-1], np.eye(len(waypoints))[1:]
        sums = np.concatenate([4 * start + 2 * end, 2 * start + 4 * end, start + end])
        return cls(times, step_q, limits, centre - reach, centre + reach, sums)

    def shortest(self, velocities: Array) -> Array:
        """Return the first durations (batch, segments) on the grid that keep the limits; infinite where none does.

        Args:
            velocities: (batch, segments + 1, joints) at the waypoints, rad/s or m/s.
        """
        segments = len(self.step_q)
        sums = self.sums @ velocities
        c = sums[:, : 2 * segments].transpose(2, 0, 1)[..., None]
        kept = np.logical_and.reduce((self.lower <= c) & (c <= self.upper), axis=0)
        allowed = kept[:, :segments] & kept[:, segments:]
        pull = 3 * self.step_q
        while True:
            first = allowed.argmax(axis=-1)
            times = self.times_s[first]
            middle = pull / times[..., None] - sums[:, 2 * segments :]
            # mostly the hulls alone show that all cubics keep the velocity limit
            if (np.abs(np.concatenate([velocities, middle], axis=1)) <= self.limits.velocity).all():
                return times
            fast = self._too_fast(velocities, middle) & (times < np.inf)
            if not fast.any():
                return times
            allowed[fast, first[fast]] = False

    def _too_fast(self, velocities: Array, middle: Array) -> NDArray[np.bool_]:
        """Return whether cubics (batch, segments) violate the velocity limit.

        A cubic's velocity is the quadratic with Bernstein coefficients ``v0, middle, v1``, so it lies in their hull.
        """
        limit = self.limits.velocity
        ends = np.abs(velocities) <= limit
        inner = np.abs(middle) <= limit
        v0, v1 = velocities[:, :-1], velocities[:, 1:]
        return ~np.all(ends[:, :-1] & ends[:, 1:] & (inner | (np.abs(_peak(v0, middle, v1)) <= limit)), axis=-1)


def _peak(v0: Array, middle: Array, v1: Array) -> Array:
    """Return the velocity at the cubic's inner extremum, or at its start if it has none.

    That is where the second derivative ``6 a t + 2 b`` is zero (the paper's section IV-C prints 6a + 2b).
    """
    bend = v0 - 2 * middle + v1
    rise = v0 - middle
    share = np.divide(rise, bend, out=np.full_like(bend, -1.0), where=bend != 0)
    return np.where((share > 0) & (share < 1), v0 - share * rise, v0)


def _shortest(waypoints: Array, velocities: Array, limits: MotionLimits, first_s: float, step_s: float) -> Array:
    """Return the shortest durations (batch, n - 1), on a grid as long as they need."""
    longest, batch = 1.0, len(velocities)
    while True:
        grid = CubicGrid.build(waypoints, limits, first_s=first_s, step_s=step_s, longest_s=longest, batch=batch)
        durations = grid.shortest(velocities)
        if np.isfinite(durations).all():
            return durations
        if longest == LONGEST_S:
            reason = f"no cubic of up to {LONGEST_S:.0f} s joins the waypoints within the motion limits"
            raise NoPlan(f"{reason}; raise the limits or bring the waypoints closer")
        longest = min(2 * longest, LONGEST_S)
