"""The smoothest motion over a shrinking horizon: sequential quadratic programs that start from the spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import factorial

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from trocar.arms import fk, jacobian
from trocar.errors import NoPlan
from trocar.geometry import SO3
from trocar.geometry.arrays import Array
from trocar.motion.check import SHORT_M, line_deviation
from trocar.motion.curve import DEGREE, Curve
from trocar.motion.double_integrator import duration_bound_s
from trocar.motion.limits import limit_use
from trocar.motion.optimal import straight_pieces
from trocar.motion.planners import Demand, TimedPath, ignores
from trocar.motion.problem import JOINTS, ArmMotion, MotionProblem
from trocar.motion.qp import FREE, Program
from trocar.motion.splines import spline
from trocar.trajectory import Trajectory

SAMPLE_S = 0.01  # step by which the horizon shrinks: the control period
KNOTS = 16  # pieces of the cubic spline on each piece of the path
LINEARISED = 5  # maximum number of programs for one horizon
SHORTER = 0.85  # a single piece is shortened down to this share of its time
LONGER, LONGEST = 1.2, 12  # if the spline's horizon is too short, it grows by this factor, at most this many times
ROOM = 0.85  # share of the channel's width that is used at the samples
SLACK = 1e-3  # a program may leave the channel by this share of its width; the channel is checked again at 1 kHz
KEPT = 1 - 1e-6  # share of each limit that is used
# Cost of leaving the channel by its own width, relative to the mean square of the jerks in accelerations per knot.
PENALTY = 1e3
PRECISION, ITERATIONS = 1e-7, 60  # of the solver: a solution takes 15 to 30; times are exact, from the splines


@ignores(Demand.DISTANCES, Demand.TIP_SPEED, Demand.FACING)
def sqp(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return each arm's smoothest motion over its shortest feasible horizon, planned separately.

    Hwang et al. 2022, section IV-D. For a horizon, the sum of the squared jerks is minimised within the limits of
    range, velocity, acceleration and, if given, jerk; all waypoints are passed, and on straight pieces the tip stays in
    a channel as wide as the problem's tolerance, linearised about the previous motion and with a penalised slack. The
    spline is the first motion and its duration the first horizon. The authors shorten it by one sample until there is
    no solution; here it is bisected, and then so is each piece by itself.

    Unlike in the paper, all pieces form one program, the splines are cubic (their jerk is finite), and if the horizon
    of the spline is too short (because of a jerk limit or a narrow channel), a longer one is searched for. If none has
    a solution, the spline is the answer.
    """
    return {name: _Refinement(problem.arms[name], problem).shortest(path) for name, path in spline(problem).items()}


@dataclass(frozen=True, eq=False)
class HeldSpline:
    """All joints' clamped cubic B-spline over the share of the time; the control points between its ends are free.

    The variables of its programs are the free control points, joint by joint, relative to the straight line between
    both ends (to avoid subtracting large numbers), and one slack.
    """

    curve: Curve  # with the pieces' knots
    # (a, joints) control points at its start: two at one place for rest, three to accelerate from 0 as well
    first: Array
    last: Array  # (b, joints) those at its end

    def rows(self, basis: Array, gradient: Array, slack: float = 0.0) -> tuple[sparse.csr_matrix, Array]:
        """Return rows and constants (k,) of ``gradient . q + slack * s`` at a basis (k, controls), s the slack."""
        free = basis[:, len(self.first) : len(self.first) + self.free]
        moved = (gradient[:, :, None] * free[:, None, :]).reshape(len(basis), gradient.shape[1] * self.free)
        matrix = sparse.csr_matrix(np.column_stack([moved, np.full(len(basis), slack)]))
        return matrix, np.einsum("kj,kc,cj->k", gradient, basis, self._line)

    def each_joint(self, basis: Array, scale: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return the rows of each joint by itself (joints * k), joint by joint, divided by ``scale (joints,)``."""
        return self.rows(np.tile(basis, (len(scale), 1)), np.repeat(np.diag(1 / scale), len(basis), axis=0))

    @property
    def free(self) -> int:
        """Return how many control points of a joint are free."""
        return self.curve.controls - len(self.first) - len(self.last)

    def control(self, free: Array) -> Array:
        """Return all control points (.., joints) from the free ones' offsets from the line, joint by joint."""
        control = self._line.copy()
        control[len(self.first) : -len(self.last)] += free.reshape(self.first.shape[1], -1).T
        return control

    def trajectory(self, control: Array, seconds: float) -> Trajectory:
        """Return the motion that takes this time."""
        spline, knots, orders = BSpline(self.curve.padded, control, DEGREE), self.curve.knots, range(DEGREE, -1, -1)
        parts = [spline(knots[:-1], nu=order) / factorial(order) / seconds**order for order in orders]
        return Trajectory(seconds * knots, np.stack(parts))

    @cached_property
    def _line(self) -> Array:
        """Return the control points of a straight line between the ends, to which the free ones are relative."""
        at = self.curve.places[:, None]
        line = (1 - at) * self.first[0] + at * self.last[-1]
        line[: len(self.first)], line[-len(self.last) :] = self.first, self.last
        return line


@dataclass(frozen=True, eq=False)
class _Refinement:
    """One arm's motion, to be refined: its waypoints and constraints, and the problem with the tolerances."""

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
        """Bisect between two horizons, the longer of which has the solution ``found``; return the shortest solution."""
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
            try:
                path, slack = self._smoothest(pieces_s, path)
            except NoPlan:
                return None
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

    def _smoothest(self, pieces_s: Array, path: TimedPath) -> tuple[TimedPath, float]:
        """Return the solution linearised about a motion, and its slack in channel widths (NoPlan: it has none)."""
        times_s = np.concatenate([[0.0], np.cumsum(pieces_s)])
        spline, seconds = self._spline(times_s), float(times_s[-1])
        curve = spline.curve
        # the sum of squared jerks, in accelerations per knot, and of the penalty
        scale = self.arm.limits.acceleration * seconds**2 * len(curve.knots)
        jerks, rest = spline.each_joint(curve.basis(curve.knots[:-1], 3), scale)
        share = np.sqrt(np.tile(np.diff(curve.knots), len(scale)))
        matrix = sparse.csr_matrix(sparse.diags(share) @ jerks)
        cost = matrix.T @ (share * rest)
        cost[-1] = PENALTY
        hessian = sparse.csc_matrix(matrix.T @ matrix)
        program = Program("smoothest motion", hessian, cost, None, None, PRECISION, PRECISION, ITERATIONS)
        self._bound_joints(program, spline, seconds)
        inner = self.arm.waypoints[1:-1].T.ravel()
        passing, rest = spline.each_joint(curve.basis(times_s[1:-1] / seconds), np.ones(JOINTS))
        program.keep("waypoints", passing, inner, inner, rest)
        for piece in np.flatnonzero(self._straight).tolist():
            self._bound_channel(program, spline, path, times_s, piece)
        program.keep("slack", sparse.csr_matrix(np.eye(len(cost))[-1:]), 0.0, FREE)
        x = program.least()
        return TimedPath(spline.trajectory(spline.control(x[:-1]), seconds), times_s), float(x[-1])

    def _spline(self, times_s: Array) -> HeldSpline:
        """Return the spline with these times at the waypoints."""
        steps = [np.linspace(a, b, KNOTS, endpoint=False) for a, b in pairwise(times_s)]
        shares = np.concatenate([*steps, [times_s[-1]]]) / times_s[-1]
        begin, end = self.arm.waypoints[0], self.arm.waypoints[-1]
        rest = 2 if self.arm.limits.jerk is None else 3
        first = np.repeat(begin[None], 2 if self.arm.moves else rest, axis=0)
        first[1:] += self.arm.start_velocity * times_s[-1] * shares[1] / 3
        return HeldSpline(Curve(shares), first, np.repeat(end[None], rest, axis=0))

    def _bound_joints(self, program: Program, spline: HeldSpline, seconds: float) -> None:
        """Bound positions, velocities and accelerations at the knots, and the jerk between them."""
        model, limits, curve = self.arm.model, self.arm.limits, spline.curve
        inner, extent, slack = curve.knots[1:-1], model.upper - model.lower, self.problem.range_slack
        low, high = (np.repeat(end / extent, len(inner)) for end in (model.lower, model.upper))
        places, rest = spline.each_joint(curve.basis(inner), extent)
        program.keep("ranges", places, low - slack, high + slack, rest)
        orders = [(1, inner, limits.velocity), (2, curve.knots, limits.acceleration)]
        if limits.jerk is not None:
            orders.append((3, curve.knots[:-1], limits.jerk))
        for order, at, most in orders:
            rows, rest = spline.each_joint(curve.basis(at, order), most * seconds**order)
            program.keep(("velocity", "acceleration", "jerk")[order - 1], rows, -KEPT, KEPT, rest)

    def _bound_channel(self, program: Program, spline: HeldSpline, path: TimedPath, times_s: Array, piece: int) -> None:
        """Bound the tip's distance from a straight piece, and its rotation, in channel widths, with a slack."""
        model, ends, curve = self.arm.model, fk(self.arm.model, self.arm.waypoints[piece : piece + 2]), spline.curve
        begin, end = times_s[piece : piece + 2] / times_s[-1]
        inside = curve.knots[(curve.knots > begin) & (curve.knots < end)]
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
        offsets, basis = values - np.einsum("kdj,kj->kd", gradients, q), curve.basis(at)
        # axis by axis, first to one side of the channel and then to the other
        both = np.stack([gradients, -gradients]).transpose(2, 0, 1, 3).reshape(-1, JOINTS)
        rows, rest = spline.rows(np.tile(basis, (2 * len(width), 1)), both, slack=-1.0)
        room = 1.0 - np.stack([offsets, -offsets]).transpose(2, 0, 1).ravel()
        program.keep(f"channel {piece}", rows, -FREE, room, rest)
        along = line @ slopes[:, :3]  # the tip stays between the ends of the line
        before = gone @ line - np.einsum("kj,kj->k", along, q)
        rows, rest = spline.rows(basis, along)
        program.keep(f"line {piece}", rows, -before, float(line @ line) - before, rest)

    @cached_property
    def _straight(self) -> Array:
        return np.array(straight_pieces(self.arm))
