"""The time-optimal motion with straight pieces at its ends and a free one between."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.arms import MotionLimits, fk
from trocar.errors import TrocarError
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.double_integrator import phases_between, shortest_common_s
from trocar.motion.path import TimedPath
from trocar.motion.phases import joined
from trocar.motion.planners import Demand, ignores
from trocar.motion.problem import MotionProblem
from trocar.motion.straight_line import Sprint, StraightLine
from trocar.trajectory import Trajectory

RATES = 20
"""Passing speeds tried at each end of the free piece."""
FINE, ZOOMS = 9, 2
"""And round the best of them, so many times over."""
HEADROOM = 1e-6
"""Share of the acceleration limits that is left: what lies between two knots of a straight piece."""
PARALLEL = 1e-3
"""Sine of the angle, and turn in rad, up to which a piece counts as one along ``up``."""


@ignores(Demand.DISTANCES, Demand.JERK)
def optimal(problem: MotionProblem) -> dict[str, TimedPath]:
    """Return the time-optimal motion of each arm that follows its straight pieces strictly, planned for itself.

    A straight piece is left, or come to, along itself at a speed of the planner's choice; between two of them every
    joint goes its own way from one velocity to the other in the time that the slowest one needs. Given the speeds, all
    of that is in closed form or one pass over the line; the speeds, two in a transfer, are searched on a grid that
    is refined where it is best. Free pieces that follow one another, and straight ones, meet at rest.

    Where a problem does not say which pieces are straight, the first and the last of three or more waypoints are if
    they lie along ``up``: a block that is lifted off its peg and lowered onto another.
    """
    return {name: _planned(arm) for name, arm in problem.arms.items()}


@dataclass(frozen=True, eq=False)
class _Stage:
    """Pieces between two rests: a free one, with a straight one before it or after it or both; or a straight one.

    Attributes:
        lift: the straight piece before, from rest.
        lower: the straight piece after, from its end backwards: from rest too.
        free: (2, joints) start and end of the free piece; None: only a straight piece, ``lift``.
        v0: (joints,) velocity at the start, where a free piece comes first.
        limits: of the joints.
    """

    lift: StraightLine | None
    lower: StraightLine | None
    free: NDArray[np.float64] | None
    v0: NDArray[np.float64]
    limits: MotionLimits

    def pieces(self) -> list[Trajectory]:
        """Return the motions of the pieces, in order."""
        if self.free is None:
            assert self.lift is not None  # a stage has one of them
            return [Sprint.to(self.lift, np.zeros(1)).trajectory(0)]
        first, last = self._best_rates()
        motions = []
        v0, v1 = self.v0, np.zeros_like(self.v0)
        if self.lift is not None:
            sprint = Sprint.to(self.lift, np.array([first]))
            motions.append(sprint.trajectory(0))
            v0 = sprint.rates[0] * self.lift.slope[-1]
        end = None
        if self.lower is not None:
            sprint = Sprint.to(self.lower, np.array([last]))
            end = sprint.trajectory(0, backwards=True)
            v1 = -sprint.rates[0] * self.lower.slope[-1]
        motions.append(self._between(v0, v1))
        return motions + [end] * (end is not None)  # type: ignore[list-item]

    def _between(self, v0: NDArray[np.float64], v1: NDArray[np.float64]) -> Trajectory:
        """Return the free piece between two velocities (joints,)."""
        assert self.free is not None  # its caller knows
        step, velocity = self.free[1] - self.free[0], self.limits.velocity
        seconds = float(shortest_common_s(step, v0, v1, velocity, self.limits.acceleration))
        joints = zip(step, v0, v1, velocity, strict=True)
        return joined(self.free[0], v0, [phases_between(d, a, b, seconds, top) for d, a, b, top in joints], seconds)

    def _best_rates(self) -> tuple[float, float]:
        """Return the rates ds/dt at which the straight pieces before and after are left and come to; 0: none."""
        assert self.free is not None  # its caller knows
        ends = [_End.of(line) for line in (self.lift, self.lower)]
        step = self.free[1] - self.free[0]
        grids = [end.first_grid() for end in ends]
        for _ in range(ZOOMS + 1):
            v0 = grids[0][:, None, None] * ends[0].slope if self.lift is not None else self.v0
            v1 = -grids[1][None, :, None] * ends[1].slope
            between_s = shortest_common_s(
                step, v0 + 0 * v1, v1 + 0 * v0, self.limits.velocity, self.limits.acceleration
            )
            total_s = ends[0].seconds(grids[0])[:, None] + between_s + ends[1].seconds(grids[1])
            places = np.unravel_index(int(np.argmin(total_s)), total_s.shape)
            best = [float(grid[place]) for grid, place in zip(grids, places, strict=True)]
            grids = [end.finer(grid, int(place)) for end, grid, place in zip(ends, grids, places, strict=True)]
        return best[0], best[1]


@dataclass(frozen=True, eq=False)
class _End:
    """What a straight piece costs, by the rate at its end; without a piece there is one rate, 0, and it costs nothing.

    Attributes:
        top: greatest rate.
        slope: (joints,) by which the rate becomes velocities.
        seconds: function of rates.
    """

    top: float
    slope: NDArray[np.float64] | float
    seconds: CubicSpline | type[np.ndarray]

    @classmethod
    def of(cls, line: StraightLine | None) -> _End:
        """Return the costs of a line."""
        if line is None:
            return cls(0.0, 0.0, np.zeros_like)  # type: ignore[arg-type]
        sprint = Sprint.to(line, np.linspace(0.0, line.fastest_rate, RATES))
        return cls(float(sprint.rates[-1]), line.slope[-1], CubicSpline(sprint.rates, sprint.seconds))

    def first_grid(self) -> NDArray[np.float64]:
        """Return rates from 0 to the greatest."""
        return np.linspace(0.0, self.top, RATES) if self.top else np.zeros(1)

    def finer(self, grid: NDArray[np.float64], place: int) -> NDArray[np.float64]:
        """Return rates round one of a grid, to its neighbours."""
        if len(grid) == 1:
            return grid
        return np.linspace(grid[max(0, place - 1)], grid[min(len(grid) - 1, place + 1)], FINE)


def _planned(arm: ArmMotion) -> TimedPath:
    """Return one arm's motion."""
    limits = replace(arm.limits, acceleration=(1 - HEADROOM) * np.asarray(arm.limits.acceleration))
    straight = arm.straight if any(arm.straight) else _along_up(arm)
    if straight[0] and arm.moves:
        raise TrocarError(
            f"{arm.model.name} is under way at the start of a straight piece; 'optimal' lifts from rest, "
            "let the arm come to rest or put a free piece first"
        )
    lines = _lines(arm, straight, limits)
    motions: list[Trajectory] = []
    piece, count = 0, len(straight)
    while piece < count:
        lift = lines.get(piece)
        free = piece + (lift is not None)
        if free == count or straight[free]:
            stage = _Stage(lift, None, None, np.zeros(len(limits.velocity)), limits)
            piece = free
        else:
            after = free + 1 in lines
            lower = lines[free + 1].reversed() if after else None
            v0 = arm.start_velocity if free == 0 else np.zeros(len(limits.velocity))
            stage = _Stage(lift, lower, arm.waypoints[free : free + 2], v0, limits)
            piece = free + 1 + after
        motions += stage.pieces()
    return TimedPath.joined(motions)


def _lines(arm: ArmMotion, straight: tuple[bool, ...], limits: MotionLimits) -> dict[int, StraightLine]:
    """Return the straight pieces by their index."""
    pieces = np.flatnonzero(straight)
    if not len(pieces):
        return {}
    lines = StraightLine.between(arm.model, arm.waypoints[pieces], arm.waypoints[pieces + 1], limits)
    return dict(zip(pieces.tolist(), lines, strict=True))


def _along_up(arm: ArmMotion) -> tuple[bool, ...]:
    """Return for each piece whether it is the first or the last of several and lies along ``up`` without a turn."""
    count = len(arm.waypoints) - 1
    if count == 1:
        return (False,)
    tips = fk(arm.model, arm.waypoints)
    found = [False] * count
    for piece in (0, count - 1):
        way = tips.translation_m[piece + 1] - tips.translation_m[piece]
        turn = (tips.rotation[piece].inverse() @ tips.rotation[piece + 1]).log()
        aside = np.linalg.norm(np.cross(way, arm.up))
        found[piece] = bool(aside <= PARALLEL * np.linalg.norm(way) and np.linalg.norm(turn) <= PARALLEL)
    return tuple(found)
