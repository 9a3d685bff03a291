"""Time-optimal phases of a double integrator."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.trajectory import Trajectory

Phases = list[tuple[float, float]]
"""Duration in s and acceleration of each phase, in order."""

APART_S = 1e-9
"""Knots closer than this count as one."""

NO_WAY = 1e-15
"""Distances (rad, m) below this count as zero."""

STILL = 1e-12
"""Share of a velocity limit that counts as rest."""


def phases_to_rest(
    distance: float, start_velocity: float, seconds: float, velocity: float, acceleration: float
) -> Phases:
    """Return the phases of a joint from a moving start to rest at a signed distance in exactly this time.

    It uses as little acceleration as the time allows, and never passes its goal unless it cannot stop before it; then
    it brakes as hard as it may, to overshoot as little as possible, and comes back.

    Args:
        distance: to go, rad or m, of either sign.
        start_velocity: per second, of either sign, within the limit.
        seconds: no shorter than :func:`trocar.motion.shortest_to_rest_s`; any longer time will do.
        velocity: greatest, above 0.
        acceleration: greatest, above 0.
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
    """Return speeding up, cruising at the limit if need be, and braking, with the least acceleration.

    Up to the peak ``(a T + v0) / 2`` and down from it covers d if ``T^2 a^2 + (2 T v0 - 4 d) a = v0^2``; with a
    cruise at the limit V instead, ``d = V T - (V^2 - V v0 + v0^2 / 2) / a``.
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


def joined(q: NDArray[np.float64], v: NDArray[np.float64], phases: Sequence[Phases], seconds: float) -> Trajectory:
    """Return the trajectory of all joints from their phases, which last ``seconds`` each.

    Args:
        q: (joints,) at the start.
        v: (joints,) at the start, per second.
        phases: one list per joint.
        seconds: what every list adds up to, up to rounding.
    """
    ends = np.concatenate([np.cumsum([t for t, _ in joint]) for joint in phases])
    ends = np.unique(ends[(ends > APART_S) & (ends < seconds - APART_S)])
    knots = np.concatenate([[0.0], ends[np.diff(ends, prepend=0.0) > APART_S], [seconds]])
    columns = [_column(place, speed, joint, knots) for place, speed, joint in zip(q, v, phases, strict=True)]
    return Trajectory(knots, np.stack(columns, axis=-1))


def _column(q: float, v: float, phases: Phases, knots: NDArray[np.float64]) -> NDArray[np.float64]:
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


KEPT = 1 + 1e-9
"""An acceleration up to this share of the limit counts as keeping it, because roots are rounded."""


def shortest_between_s(
    distance: ArrayLike, v0: ArrayLike, v1: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> NDArray[np.float64]:
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
) -> NDArray[np.float64]:
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


def after_gap_s(distance: ArrayLike, v0: ArrayLike, v1: ArrayLike, acceleration: ArrayLike) -> NDArray[np.float64]:
    """Return the time from which one joint can take any longer time; 0 if it can take any from its shortest on.

    Below lies the gap of ``least_acceleration``: too late to rush through, too early to brake, come back and go on.
    Coming back it is no faster than at its faster end, so that the velocity limit does not matter.
    """
    d, a, b, push = (np.asarray(x, dtype=np.float64) for x in (distance, v0, v1, acceleration))
    sign = np.where(d >= 0, 1.0, -1.0)
    d, a, b = sign * d, sign * a, sign * b
    room = (a**2 + b**2) / 2 - push * d
    peak = np.sqrt(np.maximum(room, 0.0))  # backwards, after braking
    return np.where(room < 0, 0.0, (a + b + 2 * peak) / push)


def shortest_common_s(
    distance: NDArray[np.float64],
    v0: NDArray[np.float64],
    v1: NDArray[np.float64],
    velocity: NDArray[np.float64],
    acceleration: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the least time that all joints (the last axis) can take together, s; infinite where none was found."""
    seconds = shortest_between_s(distance, v0, v1, velocity, acceleration).max(axis=-1)
    late_s = None
    for _ in range(np.shape(distance)[-1]):
        broken = least_acceleration(distance, v0, v1, seconds[..., None], velocity) > KEPT * acceleration
        if not broken.any():
            return seconds
        if late_s is None:
            late_s = after_gap_s(distance, v0, v1, acceleration)
        seconds = np.maximum(seconds, np.where(broken, late_s, 0.0).max(axis=-1))
    broken = least_acceleration(distance, v0, v1, seconds[..., None], velocity) > KEPT * acceleration
    return np.where(broken.any(axis=-1), np.inf, seconds)


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
