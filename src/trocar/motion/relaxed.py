"""The time-optimal motion inside the clearance: near its straight pieces and inner waypoints, not on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from trocar.arms import fk, jacobian
from trocar.geometry import SE3
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.limits import CHECK_STEP_S
from trocar.motion.optimal import optimal, straight_pieces
from trocar.motion.path import TimedPath
from trocar.motion.planners import Demand, ignores
from trocar.motion.problem import MotionProblem
from trocar.motion.spline_program import FREE, JointSpline, Rows
from trocar.motion.tolerances import line_deviation, sag_m
from trocar.trajectory import Trajectory

Array = NDArray[np.float64]

KNOTS = 16
"""Pieces of the spline on each piece of the path."""
PROGRAMMES = 5
"""Maximum number of programs, each linearised about the previous motion; the second is within 0.1 % of the answer."""
ENOUGH, OVER = 0.997, 1.3
"""If a motion uses more than its tolerance, this share of it is aimed at, and the cut is this much larger than the
excess."""
ROOM = 0.995
"""Share of a tolerance that is used; the rest is a margin for what lies between the samples and for linearisation."""
SIDES, TURNS = (0.97, 0.24), (0.26, 0.93, 0.26)
"""Shares of a tolerance along and across the direction to the target, and of the rotation about these axes and ``up``:
boxes within the balls, long where it pays. The tip leans towards the target."""
DENSE = 9
"""Number of samples on the two pieces of the spline on which the tip leaves or enters a channel fast."""
SMOOTH = 1e-5
"""Weight of the changes of acceleration between knots, s^2, so that joints that are not limiting move smoothly."""
FAST = 0.8
"""A joint's velocities are bounded if they reach this share of the limit."""


@ignores(Demand.DISTANCES, Demand.JERK, Demand.TIP_SPEED, Demand.FACING)
def relaxed(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return the fastest motion of each arm that stays within the problem's tolerances, planned separately.

    Between rest and rest over a share s of the duration T, the limits of acceleration are linear in the control points
    of a quadratic spline and in T^2. So the least T follows from a linear program, except for the tip's motion, which
    is linearised about the previous motion: while lifting and lowering, the tip deviates from the straight piece by no
    more than ``straight_tolerance_m`` and ``_rad``, and over the free piece it is never lower than the lower inner
    waypoint minus ``waypoint_tolerance_m``. The first motion is that of 'optimal'; the programs converge after two or
    three.

    If there is nothing to gain (no tolerance, a moving start, waypoints other than a lift and a lowering along ``up``
    or one of them), the answer is that of 'optimal'.
    """
    exact = optimal(problem)
    return {name: _Clearance.of(problem, arm).fastest(exact[name]) for name, arm in problem.arms.items()}


@dataclass(frozen=True, eq=False)
class _Clearance:
    """Where the tip may be.

    Attributes:
        arm: its waypoints and constraints.
        lifts: whether the first piece is a straight one along ``up``.
        lowers: whether the last one is.
        tips: (n,) poses at the waypoints.
        height_m: (n,) along ``up``.
        off_m: allowed distance from the straight pieces.
        off_rad: allowed rotation there.
        below_m: allowed depth below the inner waypoints.
    """

    arm: ArmMotion
    lifts: bool
    lowers: bool
    tips: SE3
    height_m: Array
    off_m: float
    off_rad: float
    below_m: float

    @classmethod
    def of(cls, problem: MotionProblem, arm: ArmMotion) -> _Clearance:
        """Return the clearance that a problem leaves an arm."""
        straight, tips = straight_pieces(arm), fk(arm.model, arm.waypoints)
        height_m = tips.translation_m @ arm.up
        off_m = min(problem.straight_tolerance_m, problem.waypoint_tolerance_m)
        off_rad = min(problem.straight_tolerance_rad, problem.waypoint_tolerance_rad)
        below_m = problem.waypoint_tolerance_m
        return cls(arm, straight[0], straight[-1], tips, height_m, off_m, off_rad, below_m)

    @property
    def gains(self) -> bool:
        """Return whether there is something that this planner can gain."""
        straight = straight_pieces(self.arm)
        known = straight in ((True, False, True), (True, False), (False, True))
        if not known or self.arm.moves or min(self.off_m, self.off_rad, self.below_m) <= 0.0:
            return False
        ways = np.diff(self.tips.translation_m, axis=0)[list(straight)]
        aside = ways - (ways @ self.arm.up)[:, None] * self.arm.up
        return bool(np.linalg.norm(aside, axis=1).max() <= (1 - ROOM) * self.off_m)

    def fastest(self, exact: TimedPath) -> TimedPath:
        """Return the fastest motion, starting from the one that passes the waypoints exactly."""
        if not self.gains:
            return exact
        found, clearance = exact, self
        for programme in range(PROGRAMMES):
            improved = clearance.improved(found)
            if improved is None:
                break
            found = improved
            if not programme:
                continue  # linearised about a motion that is far away, so the tip deviates
            used = self.used(found)
            if max(used) <= 1.0:
                return min(exact, found, key=lambda path: path.trajectory.duration_s)
            off, turned, below = (min(1.0, 1.0 - OVER * (share - ENOUGH)) for share in used)
            clearance = replace(
                clearance,
                off_m=off * clearance.off_m,
                off_rad=turned * clearance.off_rad,
                below_m=below * clearance.below_m,
            )
        return exact

    def improved(self, path: TimedPath) -> TimedPath | None:
        """Return the fastest motion from the program linearised about this one; None if it has no solution."""
        seconds, waypoints = path.trajectory.duration_s, self.arm.waypoints
        passed = path.waypoint_times_s / seconds
        pieces = [np.linspace(a, b, KNOTS, endpoint=False) for a, b in pairwise(passed)]
        spline = JointSpline(np.concatenate([*pieces, [1.0]]), 2, waypoints[[0, 0]], waypoints[[-1, -1]])
        rows = Rows(len(waypoints[0]) * spline.free, 1)
        self._bound_rates(rows, spline, path.trajectory)
        self._bound_tip(rows, spline, path, passed)
        cost = np.zeros(rows.free + 1)
        cost[-1] = 1.0
        x = rows.least(self._smoothness(spline, seconds), cost)
        if x is None or not x[-1] > 0.0:
            return None
        motion = spline.trajectory(spline.control(x[:-1]), sqrt(x[-1]))
        limits = self.arm.limits
        pushed = float((2 * np.abs(motion.coefficients[0]) / limits.acceleration).max())
        speed = float((np.abs(motion(motion.times_s, 1)) / limits.velocity).max())
        return self._passing(motion.stretched(max(sqrt(pushed), speed)))

    def _smoothness(self, spline: JointSpline, seconds: float) -> sparse.csc_matrix:
        """Return the weights of the changes of acceleration from knot to knot, as shares of the limits."""
        pushes = spline.each_joint(spline.basis(spline.shares[:-1], 2), self.arm.limits.acceleration * seconds**2)
        count = spline.first.shape[1]
        pieces = len(spline.shares) - 1
        changes = sparse.eye(pieces - 1, pieces, 1) - sparse.eye(pieces - 1, pieces)
        jumps = sparse.kron(sparse.eye(count), changes) @ pushes.matrix(count * spline.free + 1)
        return sparse.csc_matrix(SMOOTH * (jumps.T @ jumps))

    def _bound_rates(self, rows: Rows, spline: JointSpline, motion: Trajectory) -> None:
        """Bound accelerations, which are linear in T^2, and velocities near their limits, by a tangent in T^2."""
        limits, seconds = self.arm.limits, motion.duration_s
        pushes = spline.each_joint(spline.basis(spline.shares[:-1], 2), limits.acceleration)
        for block in (pushes, -pushes):
            rows.add(block, -FREE, 0.0, weight=-1.0)
        if np.any(np.abs(motion(motion.times_s, 1)).max(axis=0) > FAST * limits.velocity):
            speeds = spline.each_joint(spline.basis(spline.shares[1:-1], 1), limits.velocity)
            for block in (speeds, -speeds):  # T <= seconds / 2 + T^2 / (2 seconds)
                rows.add(block, -FREE, seconds / 2, weight=-1 / (2 * seconds))

    def _bound_tip(self, rows: Rows, spline: JointSpline, path: TimedPath, passed: Array) -> None:
        """Bound the tip's position, linearised about the previous motion."""
        for foot, begin, end in self._channels(passed):
            inside = spline.shares[(spline.shares > begin) & (spline.shares < end)]
            top = np.linspace(begin, inside[1], DENSE) if foot else np.linspace(inside[-2], end, DENSE)
            self._bound_channel(rows, spline, path, foot, np.union1d(inside, top))
        first, end = passed[int(self.lifts)], passed[-1 - int(self.lowers)]
        over = spline.shares[(spline.shares >= first) & (spline.shares <= end)][1 - self.lifts :]
        over = over[: len(over) - 1 + self.lowers]
        q = path.trajectory(path.trajectory.duration_s * over)
        floor_m = np.full(len(over), self._floor_m)
        for inner in range(1, len(passed) - 1):
            floor_m[np.abs(over - passed[inner]) < 1e-9] = self.height_m[inner] - ROOM * self.below_m
        slopes = self.arm.up @ jacobian(self.arm.model, q)[:, :3]
        rest = fk(self.arm.model, q).translation_m @ self.arm.up - np.einsum("kj,kj->k", slopes, q)
        rows.add(spline.rows(spline.basis(over), slopes), floor_m - rest, FREE)

    def _bound_channel(self, rows: Rows, spline: JointSpline, path: TimedPath, foot: int, at: Array) -> None:
        """Bound the tip's distance from the vertical through a waypoint, and its rotation, at shares of the time."""
        q = path.trajectory(path.trajectory.duration_s * at)
        poses, gradient, axes = fk(self.arm.model, q), jacobian(self.arm.model, q), self._axes
        gone = (poses.translation_m - self.tips.translation_m[foot]) @ axes.T
        turned = (poses.rotation @ self.tips.rotation[foot].inverse()).log() @ axes.T
        slopes = np.concatenate([axes @ gradient[:, :3], axes @ gradient[:, 3:]], axis=1)  # (k, 6, joints)
        rest = np.concatenate([gone, turned], axis=1) - np.einsum("kdj,kj->kd", slopes, q)
        high = np.concatenate([self.off_m * np.array(SIDES), [FREE], self.off_rad * np.array(TURNS)])
        low = np.where(high < FREE, -high, 0.0)  # never below the place where it starts or ends
        basis = spline.basis(at)
        for row in range(len(high)):
            rows.add(
                spline.rows(basis, slopes[:, row]), ROOM * low[row] - rest[:, row], ROOM * high[row] - rest[:, row]
            )

    def _channels(self, passed: Array) -> list[tuple[int, float, float]]:
        """Return the waypoints at which straight pieces start or end, and the times from when to when they last."""
        found = [(0, 0.0, float(passed[1]))] if self.lifts else []
        return found + [(len(passed) - 1, float(passed[-2]), 1.0)] * self.lowers

    @property
    def _axes(self) -> Array:
        """Return unit vectors (3, 3) in the base: towards the target of the motion, sideways, and up."""
        up, way = self.arm.up, self.tips.translation_m[-1] - self.tips.translation_m[0]
        ahead = way - (way @ up) * up
        if np.linalg.norm(ahead) <= self.off_m:
            ahead = np.cross(up, np.roll(up, 1) + [1.0, 0.0, 0.0])
        ahead = ahead / float(np.linalg.norm(ahead))
        return np.stack([ahead, np.cross(up, ahead), up])

    @property
    def _floor_m(self) -> float:
        """Return the lowest height allowed for the tip over the free piece."""
        ends = self.height_m[int(self.lifts) : len(self.height_m) - int(self.lowers)]
        return float(ends.min() - ROOM * self.below_m)

    def _passing(self, motion: Trajectory) -> TimedPath | None:
        """Return the path; inner waypoints are passed when the tip is at their height minus the tolerance."""
        times_s, q = motion.sample(CHECK_STEP_S)
        height_m = fk(self.arm.model, q).translation_m @ self.arm.up
        passed = [0.0]
        inner = range(1, len(self.height_m) - 1)
        for waypoint in inner:
            above = np.flatnonzero(height_m >= self.height_m[waypoint] - self.below_m)
            if not len(above):
                return None
            lifted = self.lifts and waypoint == 1
            passed.append(float(times_s[above[0] if lifted else above[-1]]))
        return TimedPath(motion, np.array([*passed, motion.duration_s]))

    def used(self, path: TimedPath) -> tuple[float, float, float]:
        """Return the largest shares of the tolerances that a motion uses at 1 kHz: sideways, rotation, below."""
        pieces = np.flatnonzero(straight_pieces(self.arm)).tolist()
        strays = np.array([line_deviation(self.arm, path, piece) for piece in pieces]).max(axis=0)
        below = sag_m(self.arm, path, int(self.lifts)) / self.below_m
        return float(strays[0] / self.off_m), float(strays[1] / self.off_rad), below
