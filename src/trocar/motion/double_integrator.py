"""Joints as double integrators between two moving states: the shortest time, and the acceleration for a given time.

Closed forms for arrays of any shape that broadcast. ``distance`` is signed, in rad or m; ``v0`` and ``v1`` are the
velocities at both ends, within the limit; ``velocity`` and ``acceleration`` are the limits, above 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.motion.phases import APART_S, NO_WAY, Phases

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
