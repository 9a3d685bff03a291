"""The smoothest motion over a shrinking horizon: sequential quadratic programs that start from the spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from trocar.arms import fk, jacobian
from trocar.geometry import SO3
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.bound import duration_bound_s
from trocar.motion.limits import limit_use
from trocar.motion.optimal import straight_pieces
from trocar.motion.path import TimedPath
from trocar.motion.planners import Demand, ignores
from trocar.motion.problem import MotionProblem
from trocar.motion.spline_program import FREE, Block, JointSpline, Rows
from trocar.motion.splines import spline
from trocar.motion.tolerances import SHORT_M, line_deviation

Array = NDArray[np.float64]

SAMPLE_S = 0.01
"""Step by which the horizon shrinks: the control period."""
KNOTS = 16
"""Pieces of the cubic spline on each piece of the path."""
LINEARISED = 5
"""Maximum number of programs for one horizon."""
SHORTER = 0.85
"""A single piece is shortened down to this share of its time."""
LONGER, LONGEST = 1.2, 12
"""If the horizon of the spline is too short, it grows by this factor, at most this many times."""
ROOM = 0.85
"""Share of the channel's width that is used at the samples."""
SLACK = 1e-3
"""The channel counts as kept in a program within this share of its width; it is checked again at 1 kHz."""
KEPT = 1 - 1e-6
"""Share of each limit that is used."""
PENALTY = 1e3
"""Cost of leaving the channel by its own width, relative to the mean square of the jerks in accelerations per knot."""


@ignores(Demand.DISTANCES, Demand.TIP_SPEED, Demand.FACING)
def sqp(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return the smoothest motion over the shortest horizon that has one, of each arm, planned separately.

    Hwang et al. 2022, section IV-D. For a horizon, the sum of the squared jerks is minimised within the limits of
    range, velocity, acceleration and, if given, jerk; all waypoints are passed, and on straight pieces the tip stays in
    a channel as wide as the problem's tolerance, linearised about the previous motion and with a penalised slack. The
    spline is the first motion and its duration the first horizon. The authors shorten it by one sample until there is
    no solution; here it is bisected, and then so is each piece by itself.

    Unlike in the paper, all pieces form one program, the splines are cubic (their jerk is finite), and if the horizon
    of the spline is too short (because of a jerk limit or a narrow channel), a longer one is searched for. If none has
    a solution, the spline is the answer.
    """
    return {
        name: _Refinement(arm, problem).shortest(path) if (arm := problem.arms[name]) else path
        for name, path in spline(problem).items()
    }


@dataclass(frozen=True, eq=False)
class _Refinement:
    """One arm's motion, to be refined.

    Attributes:
        arm: its waypoints and constraints.
        problem: with the tolerances.
    """

    arm: ArmMotion
    problem: MotionProblem

    def shortest(self, path: TimedPath) -> TimedPath:
        """Return the motion over the shortest horizon, or the given one if there is none."""
        pieces_s, found = np.diff(path.waypoint_times_s), None
        for _ in range(LONGEST):
            found = self.over(pieces_s, path)
            if found is not None:
                break
            pieces_s = LONGER * pieces_s
        if found is None:
            return path
        bound_s = duration_bound_s(self.arm.waypoints, self.arm.limits, self.arm.start_velocity)
        whole_s = np.diff(found.waypoint_times_s)
        found = self._halved(found, whole_s * bound_s / whole_s.sum(), whole_s)
        for piece in range(len(whole_s)):
            least_s = np.diff(found.waypoint_times_s)
            most_s = least_s.copy()
            least_s[piece] *= SHORTER
            found = self._halved(found, least_s, most_s)
        return found

    def _halved(self, found: TimedPath, least_s: Array, most_s: Array) -> TimedPath:
        """Return the motion over the shortest horizon between two, the longer of which has a solution."""
        while (most_s - least_s).sum() > SAMPLE_S:
            middle_s = (most_s + least_s) / 2
            shorter = self.over(middle_s, found)
            if shorter is None:
                least_s = middle_s
            else:
                found, most_s = shorter, middle_s
        return found

    def over(self, pieces_s: Array, path: TimedPath) -> TimedPath | None:
        """Return the smoothest motion that takes these times (n - 1,) between the waypoints; None if there is none."""
        for _ in range(LINEARISED):
            answer = self._smoothest(pieces_s, path)
            if answer is None:
                return None
            path, slack = answer
            if slack < SLACK and self._kept(path):
                return path
        return None

    def _kept(self, path: TimedPath) -> bool:
        """Return whether limits and channels are kept at 1 kHz."""
        use = limit_use(self.arm.model, path.trajectory, self.arm.limits)
        if max(use.velocity_ratio, use.acceleration_ratio, use.jerk_ratio) > 1.0:
            return False
        strays = [line_deviation(self.arm, path, piece) for piece in np.flatnonzero(self._straight).tolist()]
        tolerances = self.problem.straight_tolerance_m, self.problem.straight_tolerance_rad
        return all(off_m <= tolerances[0] and off_rad <= tolerances[1] for off_m, off_rad in strays)

    def _smoothest(self, pieces_s: Array, path: TimedPath) -> tuple[TimedPath, float] | None:
        """Return the solution of the program linearised about a motion, and its slack in widths of the channel."""
        times_s = np.concatenate([[0.0], np.cumsum(pieces_s)])
        curve = self._curve(times_s)
        rows = Rows(curve.first.shape[1] * curve.free, 1)
        self._bound_joints(rows, curve, float(times_s[-1]))
        passing = curve.each_joint(curve.basis(times_s[1:-1] / times_s[-1]), np.ones(curve.first.shape[1]))
        inner = self.arm.waypoints[1:-1].T.ravel()
        rows.add(passing, inner, inner)
        for piece in np.flatnonzero(self._straight):
            self._bound_channel(rows, curve, path, times_s, int(piece))
        none = np.zeros(0, dtype=np.intp)
        rows.add(Block(np.zeros(0), none, none, np.zeros(1)), 0.0, FREE, weight=1.0)
        scale = self.arm.limits.acceleration * times_s[-1] ** 2 * len(curve.shares)
        jerks = curve.each_joint(curve.basis(curve.shares[:-1], 3), scale)
        share = np.sqrt(np.tile(np.diff(curve.shares), len(scale)))
        matrix = sparse.csr_matrix(sparse.diags(share) @ jerks.matrix(rows.free + 1))
        cost = matrix.T @ (share * jerks.rest)
        cost[-1] = PENALTY
        x = rows.least(sparse.csc_matrix(matrix.T @ matrix), cost)
        if x is None:
            return None
        motion = curve.trajectory(curve.control(x[:-1]), float(times_s[-1]))
        return TimedPath(motion, times_s), float(x[-1])

    def _curve(self, times_s: Array) -> JointSpline:
        """Return the spline with these times at the waypoints."""
        steps = [np.linspace(a, b, KNOTS, endpoint=False) for a, b in pairwise(times_s)]
        shares = np.concatenate([*steps, [times_s[-1]]]) / times_s[-1]
        begin, end = self.arm.waypoints[0], self.arm.waypoints[-1]
        rest = 2 if self.arm.limits.jerk is None else 3
        first = np.repeat(begin[None], 2 if self.arm.moves else rest, axis=0)
        first[1:] += self.arm.start_velocity * times_s[-1] * shares[1] / 3
        return JointSpline(shares, 3, first, np.repeat(end[None], rest, axis=0))

    def _bound_joints(self, rows: Rows, curve: JointSpline, seconds: float) -> None:
        """Bound positions, velocities and accelerations at the knots, and the jerk between them."""
        arm, limits, inner = self.arm, self.arm.limits, curve.shares[1:-1]
        extent = arm.model.upper - arm.model.lower
        slack = self.problem.range_slack
        places, count = curve.each_joint(curve.basis(inner), extent), len(inner)
        low, high = arm.model.lower / extent - slack, arm.model.upper / extent + slack
        rows.add(places, np.repeat(low, count), np.repeat(high, count))
        orders = [(1, inner, limits.velocity), (2, curve.shares, limits.acceleration)]
        if limits.jerk is not None:
            orders.append((3, curve.shares[:-1], limits.jerk))
        for order, at, most in orders:
            rows.add(curve.each_joint(curve.basis(at, order), most * seconds**order), -KEPT, KEPT)

    def _bound_channel(self, rows: Rows, curve: JointSpline, path: TimedPath, times_s: Array, piece: int) -> None:
        """Bound the tip's distance from a straight piece, and its rotation, in channel widths, with a slack."""
        model, ends = self.arm.model, fk(self.arm.model, self.arm.waypoints[piece : piece + 2])
        begin, end = times_s[piece : piece + 2] / times_s[-1]
        inside = curve.shares[(curve.shares > begin) & (curve.shares < end)]
        at = np.union1d(inside, inside - (inside[1] - inside[0]) / 2)
        q = path.trajectory(np.interp(at * times_s[-1], times_s, path.waypoint_times_s))
        tips, slopes = fk(model, q), jacobian(model, q)
        line, gone = ends.translation_m[1] - ends.translation_m[0], tips.translation_m - ends.translation_m[0]
        turn = (ends.rotation[0].inverse() @ ends.rotation[1]).log()
        done = np.clip(gone @ line / max(float(line @ line), SHORT_M**2), 0.0, 1.0)[:, None]
        turned = (tips.rotation @ (ends.rotation[0] @ SO3.exp(done * turn)).inverse()).log()
        aside = np.linalg.svd(line[None])[2][1:]
        width = ROOM * np.repeat(
            [self.problem.straight_tolerance_m / np.sqrt(2), self.problem.straight_tolerance_rad / np.sqrt(3)], [2, 3]
        )
        values = np.concatenate([gone @ aside.T, turned], axis=1) / width
        gradients = np.concatenate([aside @ slopes[:, :3], slopes[:, 3:]], axis=1) / width[:, None]
        rest, basis = values - np.einsum("kdj,kj->kd", gradients, q), curve.basis(at)
        for axis in range(len(width)):
            block = curve.rows(basis, gradients[:, axis])
            rows.add(block, -FREE, 1.0 - rest[:, axis], weight=-1.0)
            rows.add(-block, -FREE, 1.0 + rest[:, axis], weight=-1.0)
        along = line @ slopes[:, :3]
        before = gone @ line - np.einsum("kj,kj->k", along, q)
        rows.add(curve.rows(basis, along), -before, float(line @ line) - before)

    @cached_property
    def _straight(self) -> Array:
        return np.array(straight_pieces(self.arm))
