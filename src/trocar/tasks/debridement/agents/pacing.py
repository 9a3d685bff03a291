"""The pace of a motion whose commands need more acceleration than the motion itself."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.arms import ArmModel, MotionLimits, fk
from trocar.motion import ArmMotion, limit_use
from trocar.motion.convex.retime import retimed
from trocar.trajectory import Trajectory

KEPT_SHARE = 0.88  # share of the limits that commands may use; the rest is for corrections on the way
SAMPLE_S, KNOT_S = 0.02, 0.08
"""Commands are sampled at the first interval. The spline along their path has about as many knots as if they were the
second one apart."""
FEWEST_KNOTS = 6
FREE = 1e3  # the joints of the estimated motion may use this many times the limits, which are those of commands


def paced(
    arm: ArmModel, desired: Trajectory, commands: Trajectory, limits: MotionLimits
) -> tuple[Trajectory, Trajectory, NDArray[np.float64]]:
    """Slow a motion down where its commands would exceed the limits.

    What is added to a motion bends the path of its commands: they may need twice the acceleration. A guard would slow
    down all of it by one factor; this is the fastest pace along the same path on which the tip is nowhere faster than
    it was at most. That is the tip as a camera would see it: where kinematics are off, the commanded poses may be a
    quarter further apart than the real ones. A wait at the beginning stays.

    Args:
        arm: its model.
        desired: motion of the estimated joints, from rest to rest.
        commands: those sent for it, on the same time.
        limits: of the commands.

    Returns:
        Motion and commands on their new common time, from 0 on, and corresponding times (n, 2), old and new. If the
        commands keep the limits, nothing is changed.
    """
    if limit_use(arm, commands, limits).acceleration_ratio <= 1.0:
        ends = desired.times_s[[0, -1]]
        return desired, commands, np.stack([ends, ends], axis=1)
    times = np.linspace(desired.times_s[0], desired.times_s[-1], ceil(desired.duration_s / SAMPLE_S) + 1)
    sent, tips = commands(times), fk(arm, desired(times)).translation_m
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(sent, axis=0) / limits.acceleration, axis=1)))
    first = int(np.flatnonzero(way > 0)[0]) - 1
    moves = np.append(True, np.diff(way[first:]) > 0)
    shares = np.linspace(0.0, 1.0, max(FEWEST_KNOTS, ceil(desired.duration_s / KNOT_S)) + 1)
    old = np.interp(shares * way[-1], way[first:][moves], times[first:][moves])
    both = CubicSpline(shares, np.concatenate([commands(old), desired(old)], axis=1))
    fastest = float(np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / (times[1] - times[0]))
    as_sent = ArmMotion(arm, sent[[0, -1]], limits.scaled(KEPT_SHARE))
    as_seen = ArmMotion(arm, desired(times[[0, -1]]), limits.scaled(FREE), max_tip_m_s=fastest)
    timing = retimed(Trajectory(both.x, both.c), (as_sent, as_seen), np.zeros(0))
    at = np.interp(timing.shares * way[-1], way[first:][moves], times[first:][moves])
    follows = CubicSpline(timing.motion.times_s, desired(at), bc_type="clamped")
    slower_sent = Trajectory(timing.motion.times_s, timing.motion.coefficients[..., : sent.shape[1]])
    slower, new = Trajectory(follows.x, follows.c), np.stack([at, timing.motion.times_s], axis=1)
    if not first:
        return slower, slower_sent, new
    wait = Trajectory(np.array([0.0, times[first] - times[0]]), sent[None, :1])
    begin = Trajectory(wait.times_s, desired(times[:1])[None])
    new = np.concatenate([[[times[0], 0.0]], new + [0.0, wait.duration_s]])
    return begin.then(slower), wait.then(slower_sent), new
