"""Straight lines of the tip: the joints along them, and how fast they can be followed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from trocar.arms import ArmModel, MotionLimits, fk, jacobian
from trocar.errors import InvalidInput, NoPlan, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array, finite
from trocar.motion.limits import limit_use, require_range
from trocar.motion.moves import HOLD_S, trapezoid
from trocar.trajectory import Trajectory

NEWTON_STEPS = 12
KNOTS = 16  # in each phase of a move by ``straight``; the tip then stays within 1 um of a line of 40 mm
REACHED = 1e-11  # accuracy of the tip's pose on such a move, m and rad
PIECES = 16  # of a ``StraightLine``, followed time-optimally; the tip then stays within 1 um of a line of 40 mm
LINE_REACHED = 1e-8  # accuracy of the tip's pose on a ``StraightLine``, m and rad
TRAP = 1e-2  # share of the limits by which a simple pass may exceed them before it is redone with a look-ahead
TINY = 1e-12  # joints that move less over a line (rad or m) count as not moving


def straight(arm: ArmModel, q: ArrayLike, displacement_m: ArrayLike, limits: MotionLimits) -> Trajectory:
    """Return the motion that takes the tip along a straight line without turning it, from rest to rest.

    For the last millimetres over a peg, where a spline's bulge would touch.

    Args:
        arm: the arm that moves.
        q: (joints,) where it starts, rad or m.
        displacement_m: (3,) of the tip, in the arm's base frame.
        limits: bounds of velocity and acceleration.

    Raises:
        TrocarError: the line leaves the arm's reach or a joint's range, or is not three finite numbers.
    """
    start = finite("the start of a straight move", q, len(arm.joints))
    line = finite("the displacement of a straight move", displacement_m, 3)
    if not line.any():
        return Trajectory(np.array([0.0, HOLD_S]), start[None, None])
    dense = _along_line(arm, start, np.linspace(0, 1, KNOTS)[:, None] * line)
    slope = np.abs(np.gradient(dense, 1 / (KNOTS - 1), axis=0)).max(axis=0) + 1e-12
    velocity, acceleration = np.min(limits.velocity / slope), np.min(limits.acceleration / slope)
    corners, share, speed, push = trapezoid(velocity, acceleration)
    parts = [np.linspace(a, b, KNOTS, endpoint=False) for a, b in pairwise(corners)]
    times = np.append(np.concatenate(parts), corners[-1])
    piece = np.clip(np.searchsorted(corners, times, side="right") - 1, 0, len(push) - 1)
    since = times - corners[piece]
    along = share[piece] + speed[piece] * since + push[piece] * since**2 / 2
    rate = speed[piece] + push[piece] * since
    path = _along_line(arm, start, along[:, None] * line)
    tangent = _joint_velocity(arm, path, line)
    use = limit_use(arm, Trajectory.hermite(times, path, rate[:, None] * tangent), limits)
    stretch = max(use.velocity_ratio, np.sqrt(use.acceleration_ratio))
    trajectory = Trajectory.hermite(stretch * times, path, rate[:, None] / stretch * tangent)
    require_range(arm, limit_use(arm, trajectory, limits))
    return trajectory


def _along_line(arm: ArmModel, start: Array, offsets_m: Array) -> Array:
    """Return the joint values (n, joints) that move the tip by ``offsets_m`` (n, 3) and keep its rotation.

    Newton's method from the start's tangent, so the arm never changes its branch.
    """
    home = fk(arm, start)
    R_tip_base = home.rotation.inverse()
    q = start + _joint_velocity(arm, np.broadcast_to(start, (len(offsets_m), len(start))), offsets_m)
    for _ in range(NEWTON_STEPS):
        T = fk(arm, q)
        missing_m = home.translation_m + offsets_m - T.translation_m
        turned_rad = (T.rotation @ R_tip_base).log()
        if max(np.abs(missing_m).max(), np.abs(turned_rad).max()) < REACHED:
            return q
        q = q + _solve(arm, q, np.concatenate([missing_m, -turned_rad], axis=1))
    problem = f"cannot move its tip straight by {np.round(1000.0 * offsets_m[-1], 1).tolist()} mm"
    raise InvalidInput(arm.name, problem, "choose a shorter line or another start")


def _joint_velocity(arm: ArmModel, q: Array, velocity_m_s: Array) -> Array:
    """Return the joint velocities (n, joints) that move the tip at these velocities without turning it."""
    linear = np.broadcast_to(velocity_m_s, (len(q), 3))
    return _solve(arm, q, np.concatenate([linear, np.zeros_like(linear)], axis=1))


def _solve(arm: ArmModel, q: Array, twists: Array) -> Array:
    """Return the joint velocities (n, joints) of the tip's twists (n, 6) in the base frame."""
    try:
        return np.linalg.solve(jacobian(arm, q), twists[..., None])[..., 0].astype(np.float64)
    except np.linalg.LinAlgError:
        raise InvalidInput(arm.name, "is singular on the straight line", "choose another start") from None


@dataclass(frozen=True, eq=False)
class StraightLine:
    """Joints as a function of the share s done of a straight line of the tip, which turns as little as possible."""

    q: Array  # (PIECES + 1, joints) at equal steps of s from 0 to 1
    slope: Array  # dq/ds there
    bend: Array  # d2q/ds2 there
    limits: MotionLimits  # of the joints

    @classmethod
    def between(cls, arm: ArmModel, begin: Array, end: Array, limits: MotionLimits) -> list[StraightLine]:
        """Return the lines between the tip's poses at pairs of configurations (lines, joints), or raise OutOfReach."""
        s = np.linspace(0.0, 1.0, PIECES + 1)[:, None]
        T_begin, T_end = fk(arm, begin), fk(arm, end)
        turn = (T_begin.rotation.inverse() @ T_end.rotation).log()
        start_m, way_m = T_begin.translation_m, T_end.translation_m - T_begin.translation_m
        turned = T_begin.rotation[:, None] @ SO3.exp(s * turn[:, None])
        T = SE3.from_parts(turned, start_m[:, None] + s * way_m[:, None])
        q = begin[:, None] + s * (end - begin)[:, None]
        for _ in range(NEWTON_STEPS):
            now = fk(arm, q)
            missing_m = T.translation_m - now.translation_m
            missing = np.concatenate([missing_m, _small_turn(T.rotation.matrix, now.rotation.matrix)], axis=-1)
            if np.abs(missing).max() < LINE_REACHED:
                break
            try:
                q = q + np.linalg.solve(jacobian(arm, q), missing[..., None])[..., 0]
            except np.linalg.LinAlgError:
                raise OutOfReach(f"{arm.name} is singular on a straight piece; move its ends", arm=arm.name) from None
        else:
            sentence = f"{arm.name} cannot move its tip straight between these waypoints; bring them closer"
            raise OutOfReach(sentence, arm=arm.name)
        q[:, 0], q[:, -1] = begin, end
        from scipy.interpolate import CubicSpline  # half a second, even for commands that only print help

        curve = CubicSpline(s[:, 0], q, axis=1)
        slopes, bends = curve(s[:, 0], 1), curve(s[:, 0], 2)
        return [cls(*line, limits) for line in zip(q, slopes, bends, strict=True)]

    def reversed(self) -> StraightLine:
        """Return the same line from its end to its start."""
        return StraightLine(self.q[::-1], -self.slope[::-1], self.bend[::-1], self.limits)

    @cached_property
    def top_squares(self) -> Array:
        """Return the greatest squares (PIECES + 1,) of ds/dt within the limits.

        Velocity limits bound the rate, and so do acceleration limits: where the joints curve, two of them allow a
        common change of the rate only up to a certain speed (the maximum velocity curve of Bobrow et al. 1985).
        """
        cruising = np.min(self.limits.velocity / np.maximum(np.abs(self.slope), TINY), axis=1) ** 2
        factor = np.where(np.abs(self.slope) < TINY, TINY, self.slope)
        share, room = self.bend / factor, self.limits.acceleration / np.abs(factor)
        apart, both = share[:, None] - share[..., None], room[:, None] + room[..., None]
        return np.minimum(cruising, (both / np.maximum(apart, TINY)).min(axis=(1, 2)))

    @cached_property
    def stoppable_squares(self) -> Array:
        """Return the greatest squares (PIECES + 1,) of ds/dt from which the end can be reached within the limits.

        Computed backwards from the end: on each piece, the square x at its start is the greatest for which some change
        u of the rate is allowed. All bounds on u are linear in x, so the greatest x lies where two of them meet (Pham &
        Pham 2018, "A new approach to time-optimal path parameterization based on reachability analysis").
        """
        step = 1.0 / PIECES
        share, room = (rows[..., 0] for rows in self._rows_ahead)
        squares = self.top_squares.copy()
        reach = np.full((1,), 0.5 / step)
        for i in range(PIECES - 1, -1, -1):
            shares = np.concatenate([share[i], reach])
            above = np.concatenate([room[i], reach * squares[i + 1]])  # u <= above - shares x
            below = np.concatenate([room[i], [0.0]])  # u >= -below - shares x
            apart = np.maximum(shares[:, None] - shares, TINY)
            squares[i] = min(squares[i], ((above[:, None] + below) / apart).min())
        return squares

    @cached_property
    def fastest_squares(self) -> Array:
        """Return the greatest squares (PIECES + 1,) of ds/dt that can be reached from rest at the start."""
        squares = self._sped_up(self.top_squares)
        return squares if self.follows(squares[:, None]) else self._sped_up(self.stoppable_squares)

    def follows(self, squares: Array) -> bool:
        """Return whether these squares (PIECES + 1, k) of ds/dt keep the limits, with a small tolerance."""
        if squares[1:-1].min() <= 0.0:
            return False
        share, room = self._rows_ahead
        push = np.diff(squares, axis=0)[:, None] * PIECES / 2
        return bool(np.all(np.abs(push + share[:-1] * squares[:-1, None]) <= (1 + TRAP) * room[:-1]))

    def _sped_up(self, most: Array) -> Array:
        """Return the squares when speeding up from rest as much as possible, none above ``most`` (PIECES + 1,)."""
        step = 1.0 / PIECES
        share, room = (rows[..., 0] for rows in self._rows_ahead)
        squares = np.zeros(PIECES + 1)
        for i in range(PIECES):
            push = float((room[i] - share[i] * squares[i]).min())
            squares[i + 1] = min(squares[i] + 2 * step * push, most[i + 1])
        return squares

    @cached_property
    def _rows_ahead(self) -> tuple[Array, Array]:
        return _rows(self, 1.0 / PIECES)

    @property
    def fastest_rate(self) -> float:
        """Return the greatest ds/dt at the end, from rest at the start."""
        return float(np.sqrt(self.fastest_squares[-1]))


@dataclass(frozen=True, eq=False)
class Sprint:
    """A straight line followed from rest as fast as the limits allow, once for each of several rates at its end.

    On each piece d2s/dt2 is constant, so the square of ds/dt is linear in s. The acceleration limits are kept at both
    ends of each piece (time-optimal path parameterisation, Bobrow et al. 1985).
    """

    line: StraightLine  # what is followed
    rates: Array  # (k,) ds/dt at the end, per second
    squares: Array  # (PIECES + 1, k) of ds/dt on the way
    seconds: Array  # (k,) durations

    @classmethod
    def to(cls, line: StraightLine, rates: Array) -> Sprint:
        """Return the sprints that end at these rates (k,), each no greater than the line's ``fastest_rate``.

        Raises:
            NoPlan: the line bends the joints so much that it cannot be followed.
        """
        squares = _slowed_down(line, rates, line.top_squares)
        if not line.follows(squares):
            squares = _slowed_down(line, rates, line.reversed().stoppable_squares[::-1])
            if not line.follows(squares):
                raise NoPlan("a straight piece bends the joints too much to be followed; bring its ends closer")
        roots = np.sqrt(squares)
        return cls(line, roots[-1], squares, (2 / PIECES / (roots[:-1] + roots[1:])).sum(axis=0))

    def trajectory(self, *, backwards: bool = False) -> Trajectory:
        """Return the motion from rest up to the first rate; ``backwards``: from there back to rest at the start."""
        line, square = self.line, self.squares[:, 0]
        rate, push = np.sqrt(square), np.diff(square)[:, None] * PIECES / 2
        seconds = 2 / PIECES / (rate[:-1] + rate[1:])
        v = line.slope * rate[:, None]
        left = line.slope[:-1] * push + line.bend[:-1] * square[:-1, None]
        right = line.slope[1:] * push + line.bend[1:] * square[1:, None]
        if backwards:
            times = np.concatenate([[0.0], np.cumsum(seconds[::-1])])
            return quintics(times, line.q[::-1], -v[::-1], right[::-1], left[::-1])
        return quintics(np.concatenate([[0.0], np.cumsum(seconds)]), line.q, v, left, right)


def _slowed_down(line: StraightLine, rates: Array, most: Array) -> Array:
    """Return the squares (PIECES + 1, k) of ds/dt that end at these rates; before, as great as braking allows."""
    step, fastest = 1.0 / PIECES, line.fastest_squares
    squares = np.empty((PIECES + 1, len(rates)))
    squares[-1] = np.minimum(rates**2, fastest[-1])
    share, room = _rows(line, -step)
    for i in range(PIECES, 0, -1):
        push = (-room[i] - share[i] * squares[i]).max(axis=0)
        squares[i - 1] = np.minimum(squares[i] - 2 * step * push, most[i - 1])
    return np.minimum(squares, fastest[:, None])


def quintics(times_s: Array, q: Array, v: Array, left: Array, right: Array) -> Trajectory:
    """Return the polynomials of degree five through positions and velocities (n, joints) at these times (n,).

    ``left`` and ``right`` (n - 1, joints) are the accelerations at the start and at the end of each piece.
    """
    h = np.diff(times_s)[:, None]
    missing = np.diff(q, axis=0) - v[:-1] * h - left * h**2 / 2
    missing_v = (np.diff(v, axis=0) - left * h) * h
    missing_a = (right - left) * h**2
    cubic = (10 * missing - 4 * missing_v + missing_a / 2) / h**3
    quartic = (-15 * missing + 7 * missing_v - missing_a) / h**4
    quintic = (6 * missing - 3 * missing_v + missing_a / 2) / h**5
    return Trajectory(times_s, np.stack([quintic, quartic, cubic, left / 2, v[:-1], q[:-1]]))


def _small_turn(wanted: Array, now: Array) -> Array:
    """Return the rotation vectors (..., 3) from one rotation matrix to another, exact up to their third order."""
    turn = wanted @ np.swapaxes(now, -1, -2)
    skew = (turn - np.swapaxes(turn, -1, -2)) / 2
    return skew[..., [2, 0, 1], [1, 2, 0]]


def _rows(line: StraightLine, step: float) -> tuple[Array, Array]:
    """Return bounds on the rate's change u on the piece that begins at each knot: ``share`` and ``room``.

    They mean ``|u + share x| <= room``, (PIECES + 1, 2 joints, 1) each, with x the square of ds/dt at that knot. The
    first rows, one per joint, are the acceleration limits at the knot; the others are those one ``step`` further, where
    the square is ``x + 2 step u``.
    """
    ahead = 1 if step > 0 else -1
    next_slope = np.roll(line.slope, -ahead, axis=0) + 2 * step * np.roll(line.bend, -ahead, axis=0)
    next_bend = np.roll(line.bend, -ahead, axis=0)
    factor = np.concatenate([line.slope, next_slope], axis=1)
    factor = np.where(np.abs(factor) < TINY, TINY, factor)
    share = np.concatenate([line.bend, next_bend], axis=1) / factor
    room = np.tile(line.limits.acceleration, 2) / np.abs(factor)
    return share[..., None], room[..., None]
