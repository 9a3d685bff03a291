"""Timing of a path: the highest speeds along it within the limits of joints and tips."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from trocar.geometry.arrays import Array
from trocar.motion.check import tip_speeds_m_s
from trocar.motion.convex.scene import columns_of
from trocar.motion.limits import hulls
from trocar.motion.problem import ArmMotion
from trocar.trajectory import Trajectory

STEPS, LEAST_STEPS = 5, 25  # steps of constant acceleration along each piece of the path, and on all of it at least
HEADROOM = 2e-3  # share of every limit that is kept in reserve for what lies between the steps
LEAST = 1e-12  # slopes below this share of a limit do not bind
KEPT = 1 - 1e-7  # share of the limits that is used in the end
SAMPLES = 3  # samples per step at which the use of the limits is measured in the end


@dataclass(frozen=True, eq=False)
class Timing:
    """A path with its timing."""

    motion: Trajectory  # of all joints over time, exactly on the path: polynomials of degree 6, or 2 on a straight line
    shares: Array  # (n + 1,) of the path at the motion's knots

    def times_s(self, shares: Array) -> Array:
        """Return the times at which shares (k,) of the path, at or near the motion's knots, are passed, from 0 on."""
        return np.where(shares > 0, np.interp(shares, self.shares, self.motion.times_s), 0.0)

    def later(self, wait_s: float) -> Timing:
        """Return the same motion after a wait."""
        if wait_s <= 0:
            return self
        hold = Trajectory(np.array([0.0, wait_s]), self.motion.coefficients[-1:, :1])
        return Timing(hold.then(self.motion), np.concatenate([[0.0], self.shares]))


def retimed(path: Trajectory, arms: tuple[ArmMotion, ...], passing: Array) -> Timing:
    """Return the fastest motion from rest to rest along a path, all arms together.

    Time-optimal path parameterisation in two passes (Pham & Pham 2018), with the square of the speed linear in the
    share in every step; if limits are exceeded between the steps, the motion is slowed down a little. The path contains
    all joints side by side, linear or cubic over the share; the shares ``passing`` (k,) become knots of the motion.
    """
    knots = path.times_s
    steps = max(STEPS, ceil(LEAST_STEPS / (len(knots) - 1)))
    even = (knots[:-1, None] + np.diff(knots)[:, None] * np.arange(steps) / steps).ravel()
    shares = np.unique(np.concatenate([even, knots, passing]))
    shares = shares[np.diff(shares, prepend=-1.0) > 1e-9]
    squares = _fastest(path, shares, arms)
    motion = _composed(path, shares, np.sqrt(squares))
    speed, push = (np.abs(hulls(motion, order)) for order in (1, 2))
    stretch = max(
        float((speed / _limit(arms, "velocity")).max()), float((push / _limit(arms, "acceleration")).max()) ** 0.5
    )
    if any(arm.max_tip_m_s < inf for arm in arms):
        inside = np.linspace(0.0, 1.0, SAMPLES)
        times = (motion.times_s[:-1, None] + inside * np.diff(motion.times_s)[:, None]).ravel()
        q, v = motion(times), motion(np.minimum(times, np.nextafter(motion.times_s[-1], 0.0)), 1)
        for k, arm in enumerate(arms):
            columns = columns_of(k)
            tip = tip_speeds_m_s(arm, q[:, columns], v[:, columns]).reshape(-1, SAMPLES)
            between = np.abs(np.diff(tip, n=2, axis=1)).max(axis=1) / 8  # what a parabola hides between samples
            stretch = max(stretch, float((tip.max(axis=1) + between).max()) / arm.max_tip_m_s)
    return Timing(motion.stretched(stretch / KEPT), shares)


def _limit(arms: tuple[ArmMotion, ...], name: str) -> Array:
    return np.concatenate([getattr(arm.limits, name) for arm in arms])


def _fastest(path: Trajectory, shares: Array, arms: tuple[ArmMotion, ...]) -> Array:
    """Return the squares (n + 1,) of the greatest speeds ds/dt at the shares, from rest to rest."""
    most = (1 - HEADROOM) * _limit(arms, "acceleration")
    inner = np.minimum(shares, np.nextafter(shares[-1], 0.0))
    slope, bend = path(inner, 1) / most, path(inner, 2) / most
    speed = (1 - HEADROOM) * _limit(arms, "velocity") / most
    top = 1.0 / np.maximum((np.abs(slope) / speed).max(axis=1), LEAST) ** 2
    for k, arm in enumerate(arms):
        if arm.max_tip_m_s < inf:
            columns = columns_of(k)
            tip = tip_speeds_m_s(arm, path(inner)[:, columns], path(inner, 1)[:, columns])
            top = np.minimum(top, ((1 - HEADROOM) * arm.max_tip_m_s / np.maximum(tip, LEAST)) ** 2)
    top[0] = top[-1] = 0.0
    # in a step of width h, the push u = d(x)/ds / 2 must keep |slope u + bend x| <= 1 at its start and at its end
    h = np.diff(shares)[:, None]
    push = np.concatenate([slope[:-1], slope[1:] + 2 * h * bend[1:]], axis=1)
    pull = np.concatenate([bend[:-1], bend[1:]], axis=1)
    binds = np.abs(push) > LEAST
    lean = np.where(binds, pull / np.where(binds, push, 1.0), 0.0)
    width = np.where(binds, 1 / np.where(binds, np.abs(push), 1.0), inf)
    free = np.where(~binds & (np.abs(pull) > LEAST), 1 / np.maximum(np.abs(pull), LEAST), inf).min(axis=1)
    top[:-1] = np.minimum(top[:-1], np.minimum(free, _widest(lean, width)))
    top = np.minimum(top, 1e12)
    # the next value is x + 2 h u, with |u + lean x| <= width
    share, more = 1 - 2 * h * lean, 2 * h * width
    back = np.where(share > 0, 1 / np.where(share > 0, share, 1.0), inf)
    can = top.tolist()
    for i in range(len(h) - 1, -1, -1):  # with the least push, the next value must not exceed its bound
        can[i] = min(can[i], float(((can[i + 1] + more[i]) * back[i]).min()))
    for i in range(len(h)):  # with the greatest push
        can[i + 1] = max(0.0, min(can[i + 1], float((share[i] * can[i] + more[i]).min())))
    return np.array(can)


def _widest(lean: Array, width: Array) -> Array:
    """Return the greatest x (n,) at which some push lies within all |u + lean x| <= width (n, k)."""
    if not lean.any():
        return np.full(len(lean), inf)
    apart = np.abs(lean[:, :, None] - lean[:, None, :])
    room = width[:, :, None] + width[:, None, :]
    return np.where(apart > LEAST, room / np.maximum(apart, LEAST), inf).min(axis=(1, 2))


def _composed(path: Trajectory, shares: Array, speeds: Array) -> Trajectory:
    """Return the path with the share a quadratic of time in every step: q(s(t)), polynomials of degree 6."""
    h, begin, end = np.diff(shares), speeds[:-1], speeds[1:]
    seconds = 2 * h / np.maximum(begin + end, 1e-9)
    w, u = begin[:, None], ((end - begin) / seconds / 2)[:, None]  # s - s0 = w t + u t^2
    middle = (shares[1:] + shares[:-1]) / 2
    piece = np.clip(np.searchsorted(path.times_s, middle, side="right") - 1, 0, len(path.times_s) - 2)
    since = (shares[:-1] - path.times_s[piece])[:, None]
    if len(path.coefficients) == 2:
        slope, start = path.coefficients[:, piece]
        terms = [slope * u, slope * w, start + slope * since]
        return Trajectory(np.concatenate([[0.0], np.cumsum(seconds)]), np.stack(terms))
    c3, c2, c1, c0 = path.coefficients[:, piece]
    d0 = ((c3 * since + c2) * since + c1) * since + c0
    d1 = (3 * c3 * since + 2 * c2) * since + c1
    d2, d3 = 3 * c3 * since + c2, c3
    terms = [
        d3 * u**3,
        3 * d3 * w * u**2,
        d2 * u**2 + 3 * d3 * w**2 * u,
        2 * d2 * w * u + d3 * w**3,
        d1 * u + d2 * w**2,
        d1 * w,
        d0,
    ]
    return Trajectory(np.concatenate([[0.0], np.cumsum(seconds)]), np.stack(terms))
