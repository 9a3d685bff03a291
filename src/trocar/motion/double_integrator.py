"""Time-optimal motion of joints as double integrators: least times, phases, and the bound that follows."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import MotionLimits
from trocar.geometry.arrays import Array
from trocar.motion.limits import KEPT
from trocar.trajectory import Trajectory

Phases = list[tuple[float, float]]  # duration in s and acceleration of each phase, in order

APART_S = 1e-9  # knots closer than this count as one
NO_WAY = 1e-15  # distances (rad, m) below this count as zero
STILL = 1e-12  # share of a velocity limit that counts as rest
ROUNDING = 1e-12  # share of a distance that counts as rounding


def shortest_rest_to_rest_s(distance: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the least time from rest to rest over a distance >= 0: a trapezoid of velocity, s."""
    distance, velocity, acceleration = (np.asarray(x, dtype=np.float64) for x in (distance, velocity, acceleration))
    ramp = velocity**2 / acceleration
    bang_bang = 2 * np.sqrt(distance / acceleration)
    return np.where(distance <= ramp, bang_bang, distance / velocity + velocity / acceleration)


def shortest_to_rest_s(
    distance: ArrayLike, start_velocity: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Array:
    """Return the least time from a moving start to rest at a distance of either sign, s.

    If braking at once would stop short of the goal, the joint goes on first; if braking overshoots or leads away, the
    joint comes back from rest.
    """
    d, v0, v, a = (np.asarray(x, dtype=np.float64) for x in (distance, start_velocity, velocity, acceleration))
    braking_s, stop = np.abs(v0) / a, v0 * np.abs(v0) / (2 * a)
    missed = np.abs(d - stop)
    # if braking ends at the goal, the root of a rounding error would cost microseconds
    missed = np.where(missed <= ROUNDING * (np.abs(d) + np.abs(stop)), 0.0, missed)
    back = braking_s + shortest_rest_to_rest_s(missed, v, a)
    # continuing saves the part of the ramp already done, as if the joint had started earlier from rest
    behind = v0**2 / (2 * a)
    on = shortest_rest_to_rest_s(np.abs(d) + behind, v, a) - braking_s
    return np.where((d - stop) * v0 > 0, on, back)


def shortest_between_s(
    distance: ArrayLike, v0: ArrayLike, v1: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Array:
    """Return the least time of one joint between two moving states, s.

    Full acceleration in one direction up to a peak, then in the other; at the velocity limit a cruise between.
    """
    d, a, b, v, push = (np.asarray(x, dtype=np.float64) for x in (distance, v0, v1, velocity, acceleration))
    direct = (a + b) / 2 * np.abs(b - a) / push  # distance covered if the velocity changes as fast as allowed
    sign = np.where(d >= direct, 1.0, -1.0)
    d, a, b = sign * d, sign * a, sign * b
    peak = np.sqrt(np.maximum(push * d + (a**2 + b**2) / 2, 0.0))
    cruising = (2 * v - a - b) / push + (d - (2 * v**2 - a**2 - b**2) / (2 * push)) / v
    return np.where(peak <= v, (2 * peak - a - b) / push, cruising)


def least_acceleration(
    distance: ArrayLike, v0: ArrayLike, v1: ArrayLike, seconds: ArrayLike, velocity: ArrayLike
) -> Array:
    """Return the least acceleration with which one joint takes exactly this time; infinite if none does.

    It is not a monotone function of the time: a joint that passes both ends at speed may do it quickly or, stopping on
    the way, slowly, but not in between. With acceleration c to a peak and from it, ``T^2 c^2 - 2 |h| c =
    (v0 - v1)^2`` where ``h = 2 d - T (v0 + v1)`` also tells the direction of the peak.
    """
    d, a, b, t, v = (np.asarray(x, dtype=np.float64) for x in (distance, v0, v1, seconds, velocity))
    h = 2 * d - t * (a + b)
    sign = np.where(h >= 0, 1.0, -1.0)
    peaked = (np.abs(h) + np.sqrt(h**2 + (t * (a - b)) ** 2)) / t**2
    peak = sign * peaked * t / 2 + (a + b) / 2
    spare = t * v - sign * d  # remaining distance at the velocity limit
    with np.errstate(divide="ignore"):
        cruising = ((v - sign * a) ** 2 + (v - sign * b) ** 2) / 2 / np.maximum(spare, 0.0)
    return np.where(sign * peak > v, cruising, peaked)


def after_gap_s(distance: ArrayLike, v0: ArrayLike, v1: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the duration from which on one joint can take any time; 0 if it can take any from its shortest on.

    Below it lies the gap of ``least_acceleration``: too slow to pass straight through, too short to brake, come back
    and go on. Coming back, the joint is no faster than at its faster end, so the velocity limit does not matter.
    """
    d, a, b, push = (np.asarray(x, dtype=np.float64) for x in (distance, v0, v1, acceleration))
    sign = np.where(d >= 0, 1.0, -1.0)
    d, a, b = sign * d, sign * a, sign * b
    room = (a**2 + b**2) / 2 - push * d
    peak = np.sqrt(np.maximum(room, 0.0))  # backwards, after braking
    return np.where(room < 0, 0.0, (a + b + 2 * peak) / push)


def shortest_common_s(distance: Array, v0: Array, v1: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the least time that all joints (the last axis) can take together, s; infinite where none was found."""

    def broken() -> NDArray[np.bool_]:
        return least_acceleration(distance, v0, v1, seconds[..., None], velocity) > KEPT * acceleration

    seconds = shortest_between_s(distance, v0, v1, velocity, acceleration).max(axis=-1)
    late_s = None
    for _ in range(np.shape(distance)[-1]):
        late = broken()
        if not late.any():
            return seconds
        if late_s is None:
            late_s = after_gap_s(distance, v0, v1, acceleration)
        seconds = np.maximum(seconds, np.where(late, late_s, 0.0).max(axis=-1))
    return np.where(broken().any(axis=-1), np.inf, seconds)


def phases_between(distance: float, v0: float, v1: float, seconds: float, velocity: float) -> Phases:
    """Return the phases of one joint between two moving states in exactly this time, with the least acceleration."""
    if abs(distance) <= NO_WAY and not v0 and not v1:
        return [(seconds, 0.0)]
    h = 2 * distance - seconds * (v0 + v1)
    sign = 1.0 if h >= 0 else -1.0
    push = float(least_acceleration(distance, v0, v1, seconds, velocity))
    if push * seconds <= NO_WAY:
        return [(seconds, 0.0)]
    first_s = (seconds + sign * (v1 - v0) / push) / 2
    if sign * v0 + push * first_s <= velocity * KEPT:
        phases = [(first_s, sign * push), (seconds - first_s, -sign * push)]
    else:
        ramps = (velocity - sign * v0) / push, (velocity - sign * v1) / push
        phases = [(ramps[0], sign * push), (seconds - sum(ramps), 0.0), (ramps[1], -sign * push)]
    return [(max(0.0, t), a) for t, a in phases if t > APART_S / 10] or [(seconds, 0.0)]


def phases_to_rest(
    distance: float, start_velocity: float, seconds: float, velocity: float, acceleration: float
) -> Phases:
    """Return the phases of a joint from a moving start to rest at a signed distance in exactly this time.

    The joint uses as little acceleration as the time allows, and passes its goal only if it cannot stop before it; then
    it brakes as hard as it may, to overshoot as little as possible, and comes back. Any time from
    ``shortest_to_rest_s`` on is possible.
    """
    if abs(start_velocity) <= STILL * velocity:
        start_velocity = 0.0
    forward = start_velocity > 0 or (start_velocity == 0 and distance >= 0)
    sign = 1.0 if forward else -1.0
    d, v0 = sign * distance, sign * start_velocity
    stop = v0**2 / (2 * acceleration)
    if v0 > 0 and d < stop:
        braking_s = v0 / acceleration
        back = _ahead(stop - d, 0.0, seconds - braking_s, velocity, acceleration)
        return [(braking_s, -sign * acceleration), *((t, -sign * a) for t, a in back)]
    if d < v0 * seconds / 2:  # even constant braking would go too far in this time: stop there sooner, and wait
        braking_s = 2 * d / v0
        return [(braking_s, -sign * v0 / braking_s), (seconds - braking_s, 0.0)]
    return [(t, sign * a) for t, a in _ahead(d, v0, seconds, velocity, acceleration)]


def _ahead(d: float, v0: float, seconds: float, velocity: float, acceleration: float) -> Phases:
    """Return phases that speed up, cruise at the limit if need be, and brake, with the least acceleration a.

    Speeding up to the peak ``(a T + v0) / 2`` and braking covers d if ``T^2 a^2 + (2 T v0 - 4 d) a = v0^2``; with a
    cruise at the limit V, ``d = V T - (V^2 - V v0 + v0^2 / 2) / a``.
    """
    if seconds <= APART_S or (v0 == 0 and d <= NO_WAY):
        return [(max(0.0, seconds), 0.0)]
    half = 2 * d - seconds * v0
    a = (half + sqrt(half**2 + (seconds * v0) ** 2)) / seconds**2
    peak = (a * seconds + v0) / 2
    if peak <= velocity:
        a = min(a, acceleration)  # no more than rounding
        speeding_s = max(0.0, seconds / 2 - v0 / (2 * a))
        return [(speeding_s, a), (seconds - speeding_s, -a)]
    a = min((velocity**2 - velocity * v0 + v0**2 / 2) / (velocity * seconds - d), acceleration)
    speeding_s, braking_s = (velocity - v0) / a, velocity / a
    return [(speeding_s, a), (seconds - speeding_s - braking_s, 0.0), (braking_s, -a)]


def joined(q: Array, v: Array, phases: Sequence[Phases], seconds: float) -> Trajectory:
    """Return the trajectory of all joints, which start at q and v (joints,), from their phases.

    Each joint's phases add up to ``seconds``, up to rounding.
    """
    ends = np.concatenate([np.cumsum([t for t, _ in joint]) for joint in phases])
    ends = np.unique(ends[(ends > APART_S) & (ends < seconds - APART_S)])
    knots = np.concatenate([[0.0], ends[np.diff(ends, prepend=0.0) > APART_S], [seconds]])
    columns = [_column(place, speed, joint, knots) for place, speed, joint in zip(q, v, phases, strict=True)]
    return Trajectory(knots, np.stack(columns, axis=-1))


def _column(q: float, v: float, phases: Phases, knots: Array) -> Array:
    """Return one joint's coefficients (3, knots - 1) between the knots, which include the ends of its phases."""
    seconds, push = np.array(phases).T
    begins = np.concatenate([[0.0], np.cumsum(seconds[:-1])])
    speed = np.concatenate([[v], v + np.cumsum(seconds * push)[:-1]])
    place = np.concatenate([[q], q + np.cumsum(speed * seconds + push * seconds**2 / 2)[:-1]])
    middles = (knots[1:] + knots[:-1]) / 2  # a knot merged with its neighbour must not decide which phase it is
    piece = np.clip(np.searchsorted(begins, middles, side="right") - 1, 0, len(begins) - 1)
    since = knots[:-1] - begins[piece]
    v_knot = speed[piece] + push[piece] * since
    q_knot = place[piece] + speed[piece] * since + push[piece] * since**2 / 2
    return np.stack([push[piece] / 2, v_knot, q_knot])


def duration_bound_s(waypoints: ArrayLike, limits: MotionLimits, start_velocity: ArrayLike | None = None) -> float:
    """Return a lower bound of the duration of any motion through the waypoints to rest at the last, s.

    Each joint alone is a double integrator that must visit its values in order, at any velocity. Where it reverses it
    must stop, at the waypoint or beyond; elsewhere, a waypoint costs nothing. So its least time is the sum of
    rest-to-rest times over the monotone runs, exactly, and no motion of all joints beats the slowest one. A joint with
    a moving start first reverses where its run ends, or at the earliest point where it can stop, if that is further.
    The bound ignores that the joints pass a waypoint together, the path between waypoints, jerk, and obstacles.

    >>> plan = plan_through(arm, waypoints, limits)
    >>> duration_bound_s(waypoints, limits) == plan.bound_s < plan.duration_s
    True

    Args:
        waypoints: (n, joints), rad or m.
        limits: bounds of velocity and acceleration.
        start_velocity: (joints,) at the first waypoint, per second; None: at rest.
    """
    q = np.asarray(waypoints, dtype=np.float64)
    v0 = np.zeros(q.shape[1]) if start_velocity is None else np.asarray(start_velocity, dtype=np.float64)
    joints = zip(q.T, v0, limits.velocity, limits.acceleration, strict=True)
    return max(_least_s(values, start, v, a) for values, start, v, a in joints)


def _least_s(values: Array, v0: float, velocity: float, acceleration: float) -> float:
    """Return the least time in which one joint visits its values in order and rests at the last."""
    moving_s, values = 0.0, values - values[0]
    if v0:
        ahead = np.sign(v0) * np.diff(values) >= 0
        last = len(ahead) if ahead.all() else int(np.argmin(ahead))  # of the run in the direction of the velocity
        end, stop = values[last], v0 * abs(v0) / (2 * acceleration)
        near = abs(stop - end) <= ROUNDING * (abs(stop) + abs(end))
        turn = end if near or abs(end) > abs(stop) else stop
        moving_s = float(shortest_to_rest_s(turn, v0, velocity, acceleration))
        values = np.concatenate([[turn], values[last:]])
    return moving_s + float(shortest_rest_to_rest_s(_monotone_runs(values), velocity, acceleration).sum())


def _monotone_runs(values: Array) -> Array:
    """Return the lengths of the monotone runs of a sequence; reversals as small as rounding are ignored."""
    steps = np.diff(values)
    steps = steps[np.abs(steps) > ROUNDING * np.abs(values).max()]
    if not len(steps):
        return np.zeros(1)
    turns = np.flatnonzero(np.diff(np.sign(steps))) + 1
    return np.abs([run.sum() for run in np.split(steps, turns)])
