"""The planner ``optimal``: time-optimal motions of straight and free pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.arms import MotionLimits, fk
from trocar.errors import ArmMoving
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.motion.double_integrator import joined, phases_between, shortest_common_s
from trocar.motion.planners import Demand, TimedPath, ignores
from trocar.motion.problem import JOINTS, ArmMotion, MotionProblem
from trocar.motion.straight_line import Sprint, StraightLine
from trocar.trajectory import Trajectory

RATES = 16  # number of passing speeds tried at each end of the free piece
FINE, ZOOMS = 9, 2  # number of speeds tried round the best one, and how often this is repeated
HEADROOM = 1e-6  # share of the acceleration limits kept in reserve for what lies between two knots of a straight piece
SAG_M, SAG_SAMPLES = 1e-5, 40  # between straight pieces, the tip may sink this far below both ends; number of samples
TIGHTER = 4  # maximum number of times that a motion is replanned with less acceleration, by its last excess
PARALLEL = 1e-3  # sine of the angle, and rotation in rad, up to which a piece counts as being along ``up``
# The same if the wrist is still, so that the tip rotates: twice the .13 rad of a 26 mm lift, 200 mm from the centre.
NEARLY = 0.25


@ignores(Demand.DISTANCES, Demand.JERK, Demand.TIP_SPEED, Demand.FACING)
def optimal(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return the time-optimal motion of each arm that follows its straight pieces exactly, planned separately.

    A straight piece is left, or entered, along its direction at a speed that the planner chooses. On a free piece every
    joint moves independently from one velocity to the other, in the time that the slowest one needs. Given the speeds,
    all of this is in closed form or takes one pass over the line. The speeds, two in a transfer, are searched for on a
    grid that is refined round the best ones. Consecutive free pieces meet at rest, and so do consecutive straight ones.

    If a problem does not say which pieces are straight, the first and the last of several are, if they lie along
    ``up``, or nearly so with ``fixed_wrist``: a block is lifted off its peg and lowered onto another.

    A free piece next to one along ``up`` never sags below its lower end, so whatever is cleared at the waypoints is
    cleared between them. If independent joints would sag (a wide transfer after a low lift), the free piece is replaced
    by a straight one. Nothing is guaranteed for a moving start, which may itself lead below.
    """
    return {name: _planned(arm) for name, arm in problem.arms.items()}


@dataclass(frozen=True, eq=False)
class _Stage:
    """A free piece between two rests, with a straight one before it, after it or both."""

    lift: StraightLine | None  # the straight piece before, from rest
    lower: StraightLine | None  # the straight piece after, reversed, and so from rest too
    free: Array  # (2, joints) start and end of the free piece
    v0: Array  # (joints,) velocity at the start, where the free piece comes first
    limits: MotionLimits  # of the joints
    arm: ArmMotion  # whose joints

    def pieces(self) -> list[Trajectory]:
        """Return the motions of the pieces, in order."""
        motions = self._fastest()
        if self.v0.any() or self._rises(motions[int(self.lift is not None)]):
            return motions
        begin, end = self.free[:, None]
        (level,) = StraightLine.between(self.arm.model, begin, end, self.limits)
        motions = [_from_rest_to_rest(line) for line in (self.lift, level) if line is not None]
        return motions if self.lower is None else [*motions, _from_rest_to_rest(self.lower, backwards=True)]

    def _rises(self, between: Trajectory) -> bool:
        """Return whether the free piece stays above its lower end, where a piece next to it lies along ``up``."""
        if self.lift is None and self.lower is None:
            return True
        times_s = np.linspace(0.0, between.duration_s, SAG_SAMPLES)
        heights_m = fk(self.arm.model, between(times_s)).translation_m @ self.arm.up
        if heights_m.min() >= min(heights_m[0], heights_m[-1]) - SAG_M:
            return True
        feet = np.array([line.q[[0, -1]] for line in (self.lift, self.lower) if line is not None])
        return not _are_along_up(self.arm, fk(self.arm.model, feet[:, 0]), fk(self.arm.model, feet[:, 1])).any()

    def _fastest(self) -> list[Trajectory]:
        """Return the motions of the pieces without regard to sagging."""
        (first, last), lift, lower = self._best_rates(), [], []
        v0, v1 = self.v0, np.zeros_like(self.v0)
        if self.lift is not None:
            sprint = Sprint.to(self.lift, np.array([first]))
            lift, v0 = [sprint.trajectory()], sprint.rates[0] * self.lift.slope[-1]
        if self.lower is not None:
            sprint = Sprint.to(self.lower, np.array([last]))
            lower, v1 = [sprint.trajectory(backwards=True)], -sprint.rates[0] * self.lower.slope[-1]
        step, velocity = self.free[1] - self.free[0], self.limits.velocity
        seconds = float(shortest_common_s(step, v0, v1, velocity, self.limits.acceleration))
        joints = zip(step, v0, v1, velocity, strict=True)
        phases = [phases_between(d, a, b, seconds, top) for d, a, b, top in joints]
        return [*lift, joined(self.free[0], v0, phases, seconds), *lower]

    def _best_rates(self) -> tuple[float, float]:
        """Return the rates ds/dt at which the piece before is left and the one after is entered; 0: no piece."""
        ends = [_End.of(line) for line in (self.lift, self.lower)]
        step = self.free[1] - self.free[0]
        grids = [end.first_grid() for end in ends]
        best = [0.0, 0.0]
        for _ in range(ZOOMS + 1):
            v0 = grids[0][:, None, None] * ends[0].slope if self.lift is not None else self.v0
            v1 = -grids[1][None, :, None] * ends[1].slope
            limits = self.limits.velocity, self.limits.acceleration
            between_s = shortest_common_s(step, v0 + 0 * v1, v1 + 0 * v0, *limits)
            total_s = ends[0].seconds(grids[0])[:, None] + between_s + ends[1].seconds(grids[1])
            places = np.unravel_index(int(np.argmin(total_s)), total_s.shape)
            best = [float(grid[place]) for grid, place in zip(grids, places, strict=True)]
            grids = [end.finer(grid, int(place)) for end, grid, place in zip(ends, grids, places, strict=True)]
        return best[0], best[1]


@dataclass(frozen=True, eq=False)
class _End:
    """The duration of a straight piece by the rate at its end; without a piece, the only rate is 0 and takes no time.

    Its fields are the greatest rate, the slope (joints,) that turns rates into velocities, and a function from rates to
    durations, s.
    """

    top: float
    slope: Array | float
    seconds: Callable[[Array], Array]

    @classmethod
    def of(cls, line: StraightLine | None) -> _End:
        if line is None:
            return cls(0.0, 0.0, np.zeros_like)
        sprint = Sprint.to(line, np.linspace(0.0, line.fastest_rate, RATES))
        return cls(float(sprint.rates[-1]), line.slope[-1], CubicSpline(sprint.rates, sprint.seconds))

    def first_grid(self) -> Array:
        """Return rates from 0 to the greatest."""
        return np.linspace(0.0, self.top, RATES) if self.top else np.zeros(1)

    def finer(self, grid: Array, place: int) -> Array:
        """Return a finer grid of rates round one of a grid, up to its neighbours."""
        if len(grid) == 1:
            return grid
        return np.linspace(grid[max(0, place - 1)], grid[min(len(grid) - 1, place + 1)], FINE)


def _from_rest_to_rest(line: StraightLine, *, backwards: bool = False) -> Trajectory:
    return Sprint.to(line, np.zeros(1)).trajectory(backwards=backwards)


def _planned(arm: ArmMotion) -> TimedPath:
    """Return one arm's motion, within its limits between the knots of straight pieces too."""
    straight = straight_pieces(arm)
    if straight[0] and arm.moves:
        advice = "'optimal' starts a straight piece from rest: let the arm come to rest, or put a free piece first"
        raise ArmMoving(arm.model.name, advice)
    share, most = 1 - HEADROOM, np.asarray(arm.limits.acceleration)
    path = _joined(arm, straight, replace(arm.limits, acceleration=share * most))
    for _ in range(TIGHTER):
        used = float((_most_acceleration(path.trajectory) / arm.limits.acceleration).max())
        if used <= 1.0:
            break
        share *= (1 - HEADROOM) / used
        path = _joined(arm, straight, replace(arm.limits, acceleration=share * most))
    return path


def _most_acceleration(motion: Trajectory) -> Array:
    """Return the greatest acceleration (joints,) between the knots of polynomials of up to degree five."""
    if len(motion.coefficients) < 6:
        return np.zeros(motion.coefficients.shape[2])
    fifth, fourth, third, second = motion.coefficients[:4]
    a, b, c = 10 * fifth, 4 * fourth, third  # the jerk is 6 (a t^2 + b t + c)
    root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))
    share = np.where(np.abs(a) < np.finfo(float).tiny, 1.0, 2 * a)
    times = np.clip(np.stack([root - b, -root - b]) / share, 0.0, np.diff(motion.times_s)[:, None])
    return np.abs(2 * second + times * (6 * third + times * (12 * fourth + times * 20 * fifth))).max(axis=(0, 1))


def _joined(arm: ArmMotion, straight: tuple[bool, ...], limits: MotionLimits) -> TimedPath:
    """Return one arm's motion, planned with these limits."""
    which = np.flatnonzero(straight)
    lines: dict[int, StraightLine] = {}
    if len(which):
        found = StraightLine.between(arm.model, arm.waypoints[which], arm.waypoints[which + 1], limits)
        lines = dict(zip(which.tolist(), found, strict=True))
    motions: list[Trajectory] = []
    piece = 0
    while piece < len(straight):
        lift = lines.get(piece)
        free = piece + (lift is not None)
        if lift is not None and (free == len(straight) or straight[free]):
            motions.append(_from_rest_to_rest(lift))
            piece = free
            continue
        after = free + 1 in lines
        lower = lines[free + 1].reversed() if after else None
        v0 = arm.start_velocity if free == 0 else np.zeros(JOINTS)
        motions += _Stage(lift, lower, arm.waypoints[free : free + 2], v0, limits, arm).pieces()
        piece = free + 1 + after
    return TimedPath.joined(motions)


def straight_pieces(arm: ArmMotion) -> tuple[bool, ...]:
    """Return for each piece whether it is straight, as declared.

    If nothing is declared, the first and the last of several are straight if they lie along ``up`` without a turn.
    """
    count = len(arm.waypoints) - 1
    if any(arm.straight) or count == 1:
        return arm.straight
    tips, ends, found = fk(arm.model, arm.waypoints), np.array([0, count - 1]), [False] * count
    found[0], found[-1] = _are_along_up(arm, tips[ends], tips[ends + 1]).tolist()
    return tuple(found)


def _are_along_up(arm: ArmMotion, begin: SE3, end: SE3) -> NDArray[np.bool_]:
    """Return whether the ways between poses (n,) of an arm's tip lie along ``up`` without a turn, or nearly so."""
    way, near = end.translation_m - begin.translation_m, NEARLY if arm.fixed_wrist else PARALLEL
    turn = (begin.rotation.inverse() @ end.rotation).log()
    aside = way - (way @ arm.up)[:, None] * arm.up
    straight = np.linalg.norm(aside, axis=1) <= near * np.linalg.norm(way, axis=1)
    return straight & (np.linalg.norm(turn, axis=1) <= near)
