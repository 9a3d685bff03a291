"""Bounds on the dexterity over whole arcs of the circle, by interval arithmetic through the closed form.

The pose of the tip is ``h0 + h1 cos(theta) + h2 sin(theta)``, whose range over an arc is known exactly. The arm's own
closed-form inverse kinematics, evaluated on these ranges, encloses the joints. The margin is monotone or convex in each
joint's largest angle, so that its maximum over a box of angles lies at a corner. Manipulability is a product of the
joints' sines and cosines. Nothing is sampled.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel
from trocar.arms.inverse import closed_form
from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning.interval import Interval, IntervalMath
from trocar.tasks.suture.planning.joints import LIMIT_TOLERANCE, ROLL, tip_harmonics
from trocar.tasks.suture.planning.primitive import places
from trocar.tasks.suture.planning.rewards import JOINTS, MARGINS, NO_SOLUTION, DexterityMap

YAW = 0
ManipulabilityBounds = Callable[[NDArray[np.float64], NDArray[np.float64]], tuple[NDArray, NDArray]]


@dataclass(frozen=True, eq=False)
class JointRanges:
    """Ranges of the joints along sutures on arcs of the circle.

    Attributes:
        q: six intervals (2, k, c): directions, places along the suture, arcs. The roll is in one of two windings.
        other_roll: the roll in the other winding; usually the same.
        real: (2, k, c) whether the arm certainly has a solution.
        unreal: (2, k, c) whether it certainly has none.
    """

    q: tuple[Interval, ...]
    other_roll: Interval
    real: NDArray[np.bool_]
    unreal: NDArray[np.bool_]

    @property
    def windings(self) -> tuple[tuple[Interval, ...], ...]:
        """Return the joints with the roll in the one winding, then in the other."""
        return self.q, (*self.q[:ROLL], self.other_roll, *self.q[ROLL + 1 :])


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds over arcs (c,) of the circle, one row per direction.

    Attributes:
        upper: (2, c) no suture on the arc has a larger dexterity.
        lower: (2, c) none has a smaller one, if the margin's formula is monotone in each angle; no proof depends on it.
        possible: (2, c) whether a suture on the arc may be feasible.
        certain: (2, c) whether all sutures on the arc are certainly feasible.
    """

    upper: NDArray[np.float64]
    lower: NDArray[np.float64]
    possible: NDArray[np.bool_]
    certain: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DexterityEnclosure:
    """Bounds on the dexterity between the positions of a map.

    Attributes:
        map: gives setup, reward and scales.
        manipulability_bounds: takes the ends (c,), (c,) of arcs to the smallest and largest M over them; needed if M
            was given to the map as a function.
    """

    map: DexterityMap
    manipulability_bounds: ManipulabilityBounds | None = None

    def __post_init__(self) -> None:
        if self.map.manipulability_at is not None and self.manipulability_bounds is None:
            raise TrocarError(
                "manipulability was given to this map as a function of the position, so its values between positions "
                "are unknown; give manipulability_bounds too, such as interpolated_bounds(places, values)"
            )

    def over(self, start_rad: ArrayLike, end_rad: ArrayLike) -> Bounds:
        """Return the bounds over the arcs from ``start_rad`` (c,) to ``end_rad`` (c,)."""
        start, end = np.asarray(start_rad, dtype=np.float64), np.asarray(end_rad, dtype=np.float64)
        with np.errstate(all="ignore"):
            ranges = self.joints(Interval(start, end))
            margin = self._margin(ranges)
            given = self._manipulability(ranges, start, end)
            (q_offset, q_unit), (m_offset, m_unit) = self.map.scales
            weight = self.map.reward.weight
            value = weight * (margin - q_offset) / q_unit + (1.0 - weight) * ((given - m_offset) / m_unit)
            possible, certain = self._feasible(ranges)
        return Bounds(value.high + 1e-12, value.low - 1e-12, possible, certain)

    def joints(self, theta: Interval) -> JointRanges:
        """Return the ranges of the joints on arcs (c,)."""
        arm = self._arm
        pose = _turned(self._harmonics, theta)
        rows = [[pose[i, j] for j in range(4)] for i in range(3)]
        *q, cosine = closed_form([*rows, []], IntervalMath, arm.solver_constants)
        middle = arm.middle_floats
        q[YAW] = _turned_to(q[YAW], middle[YAW])
        q[ROLL], other = _unwound(q[ROLL], middle[ROLL])
        size = abs(cosine)
        return JointRanges(tuple(q), other, size.high <= 1.0, size.low > 1.0)

    @cached_property
    def _along(self):
        return places(self.map.setup)

    @cached_property
    def _harmonics(self) -> NDArray[np.float64]:
        return np.moveaxis(tip_harmonics(self.map.setup, self._along), (-2, -1), (1, 2))[:, :3]

    @property
    def _arm(self) -> ArmModel:
        return self.map.setup.arm

    def _margin(self, ranges: JointRanges) -> Interval:
        """Return the margin (2, c) before scaling."""
        arm, reward = self._arm, self.map.reward
        which, formula = range(6)[JOINTS[reward.joints]], MARGINS[reward.margin]
        limit = ((arm.upper - arm.lower) / 2)[list(which)]
        looked_at = self._along.station if reward.at == "stations" else np.ones(len(self._along.station), dtype=bool)
        found = None
        for q in ranges.windings:
            largest = [abs(q[i] - arm.middle_floats[i])[:, looked_at] for i in which]
            # monotone or convex in each angle: the extremes over the box of angles lie at its corners
            ends = [(size.low.max(1), size.high.max(1)) for size in largest]
            values = np.stack([formula(limit, np.stack(corner, -1)) for corner in itertools.product(*ends)])
            margin = Interval.around(values.min(0), values.max(0))
            found = margin if found is None else found.hull(margin)
        assert found is not None
        none = Interval(*np.broadcast_arrays(NO_SOLUTION, NO_SOLUTION, found.low)[:2])
        # one place without a solution is enough, because the course of the roll is then unknown
        found = found.where(ranges.real.all(1), found.hull(none))
        return none.where(ranges.unreal.any(1), found)

    def _manipulability(self, ranges: JointRanges, start: NDArray, end: NDArray) -> Interval:
        """Return M (c,) before scaling: that of the surrogate, or the one given."""
        if self.manipulability_bounds:
            return Interval.around(*self.manipulability_bounds(start, end))
        arm = self._arm
        (_, s1), (_, s2) = arm.twist_cosines[1:]
        _, pitch, insertion, _, wrist, _ = (value + offset for value, offset in zip(ranges.q, arm.offsets, strict=True))
        depth = -arm.wrist_sign * insertion
        none = Interval.around(*np.broadcast_arrays(arm.offsets[1], arm.offsets[1], pitch.low)[:2])
        # where the arm has no solution, the surrogate uses a pitch of 0, so only its offset is left
        pitch = none.where(ranges.unreal, pitch.where(ranges.real, pitch.hull(none)))
        found = ((s1 * s2 * pitch.sin()) * (depth * (depth * wrist.cos() + arm.wrist_length_m))).square()
        count = found.low.shape[0] * found.low.shape[1]
        low, high = found.low.sum((0, 1)) / count, found.high.sum((0, 1)) / count
        return Interval.around(low - 1e-14 * np.abs(low), high + 1e-14 * np.abs(high))

    def _feasible(self, ranges: JointRanges) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return whether sutures (2, c) may be within the limits and deep enough, and whether they certainly are."""
        arm = self._arm
        shallowest = arm.safe_depth_m - LIMIT_TOLERANCE
        depth = -arm.wrist_sign * (ranges.q[2] + arm.offsets[2])
        possible, certain = [], []
        for q in ranges.windings:
            some, every = ~ranges.unreal & (depth.high >= shallowest), ranges.real & (depth.low >= shallowest)
            for value, joint in zip(q, arm.joints, strict=True):
                lower, upper = joint.lower - LIMIT_TOLERANCE, joint.upper + LIMIT_TOLERANCE
                some &= (value.high >= lower) & (value.low <= upper)
                every &= (value.low >= lower) & (value.high <= upper)
            possible.append(some.all(1))
            certain.append(every.all(1))
        # which of the two windings it is remains unknown: possible in either, certain in both
        return possible[0] | possible[1], certain[0] & certain[1]


def interpolated_bounds(places_rad: ArrayLike, values: ArrayLike) -> ManipulabilityBounds:
    """Return the bounds over arcs of values interpolated linearly between places (p,) round the circle.

    A piecewise linear function has its extremes at the ends of the arc or at the places within it.
    """
    around = np.mod(np.asarray(places_rad, dtype=np.float64), TURN)
    order = np.argsort(around)
    around, at_places = around[order], np.asarray(values, dtype=np.float64)[order]

    def bounds(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        ends = np.interp([start, end], around, at_places, period=TURN)
        passed = np.mod(around[:, None] - start, TURN) <= end - start + 1e-12
        inside = np.where(passed, at_places[:, None], np.nan)
        both = np.concatenate([ends, inside])
        return np.nanmin(both, axis=0), np.nanmax(both, axis=0)

    return bounds


def _turned(parts: NDArray[np.float64], theta: Interval) -> Interval:
    """Return ``h0 + h1 cos(theta) + h2 sin(theta)`` (..., c) of parts (3, ...) on arcs (c,).

    On less than half a turn this has at most one crest or trough, which the slopes at both ends reveal. Rounding is
    below four units in the last place of the largest term.
    """
    constant, cosine, sine = parts[..., None]
    swing = np.hypot(cosine, sine)
    (at_low, up_low), (at_high, up_high) = (
        (cosine * np.cos(end) + sine * np.sin(end), sine * np.cos(end) - cosine * np.sin(end))
        for end in (theta.low, theta.high)
    )
    slack, long = 1e-14 * swing, theta.width > 3.0
    low = np.where((up_low <= slack) & (up_high >= -slack) | long, -swing, np.minimum(at_low, at_high))
    high = np.where((up_low >= -slack) & (up_high <= slack) | long, swing, np.maximum(at_low, at_high))
    rounding = 1e-15 * (2 * swing + np.abs(constant))
    return Interval.around(constant + low - rounding, constant + high + rounding)


def _turned_to(angle: Interval, middle: float) -> Interval:
    """Return the angle in the turn nearest to the middle; that whole turn where the angle may be in two of them."""
    turns = np.rint(np.nan_to_num((middle - angle.middle) / TURN)) * TURN
    angle = angle + Interval(turns, turns)
    astray = (angle.low < middle - math.pi) | (angle.high > middle + math.pi)
    whole = Interval(np.minimum(angle.low, middle - math.pi), np.maximum(angle.high, middle + math.pi))
    return whole.where(astray, angle)


def _unwound(roll: Interval, middle: float) -> tuple[Interval, Interval]:
    """Return the roll (2, k, c) as ``joints.unwound`` does, in the two possible windings; unbounded where unknown."""
    known = np.asarray(np.isfinite(roll.width).all(1))
    mid = np.where(known[:, None], np.nan_to_num(roll.middle), 0.0)
    run = np.unwrap(mid, axis=1)
    moved = roll + Interval(run - mid, run - mid)
    apart = moved[:, 1:] - moved[:, :-1]
    known &= (np.abs(apart.low) < math.pi).all(1) & (np.abs(apart.high) < math.pi).all(1)
    center = Interval.around(
        (moved.low.max(1) + moved.low.min(1)) / 2 - middle, (moved.high.max(1) + moved.high.min(1)) / 2 - middle
    )
    first, last = np.rint(center.low / TURN - 1e-12), np.rint(center.high / TURN + 1e-12)
    known &= last - first <= 1
    unbounded = Interval(*np.broadcast_arrays(-np.inf, np.inf, moved.low)[:2])

    def wound(turns: NDArray[np.float64]) -> Interval:
        back = TURN * np.nan_to_num(turns)[:, None]
        return (moved - Interval(back, back)).where(known[:, None], unbounded)

    return wound(first), wound(last)
