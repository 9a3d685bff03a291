"""Commands that bring the gripper to where it should be (Kehoe 2014, V-A.2: inverse control)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, make_interp_spline

from trocar.arms import ArmModel, MotionLimits, fk, ik_near
from trocar.errors import OutOfReach
from trocar.geometry import SE3
from trocar.trajectory import Trajectory

STEP_S = 0.05  # commands are found for moments this far apart, and joined by a cubic spline
NODE_M = 0.015  # corrections are computed at places this far apart on the path, and interpolated between them
KEPT_SHARE = 0.97  # share of the limits used by corrected commands, since a guard checks them more finely
LEAST_PUSH = 0.01  # share of the limits by which a correction may exceed what is kept: a spline swings after a ramp
RAMPS_S = (0.25, 0.4, 0.6, 0.9)  # a correction is made in the shortest of these times that the limits allow
LITTLE = np.array([0.06, 0.06, 1e-3, 0.06, 0.06, 0.06])
"""Tolerated error of a joint's command, rad and m: in the wrist it is 1 mm at the tip, which the camera sees."""
FADE_S = 0.5  # time constant with which a correction stops changing, after the last place where it is computed
SHORT = 5e-3
"""Commands keep this share of their range from its ends, because a spline through them overshoots a little."""
APART_M = 1e-3  # places closer to each other than this get the same correction
ROUNDS = 4
"""The error depends on the command that it corrects, but changes by tenths at most, so few rounds are enough."""


def commands_for(
    arm: ArmModel,
    desired: Trajectory,
    estimate: Callable[[SE3], SE3],
    *,
    q_start: NDArray[np.float64],
    velocity: NDArray[np.float64],
    until_s: float | None = None,
) -> Trajectory:
    """Return the joints to be commanded so that the tip follows ``desired``.

    Args:
        arm: its model.
        desired: motion of the joints as a camera would confirm them.
        estimate: the pose in the base that is expected at a kinematic pose.
        q_start: (6,) current command; its difference to the first command fades out along the way.
        velocity: (6,) of the commands now.
        until_s: time of the motion at which the arm will stop, if estimates further on are to be ignored. Then commands
            that would leave a joint's range stay at its end, since such estimates are off by centimetres.

    Raises:
        OutOfReach: a command would leave a joint's range.
    """
    times = _moments(desired)
    commands = _followed(arm, desired, times, estimate, q_start, until_s)
    # after a change of the estimate, no command may lead to where the arm is now; so the motion starts at ``q_start``
    commands = commands + (q_start - commands[0]) * (1 - _ramp(times))[:, None]
    commands = np.concatenate([q_start[None], _inside(arm, commands[1:], clamps=until_s is not None)])
    # the correction is smooth; a spline through the sum would overshoot where the motion's acceleration jumps
    return desired.plus(_spline(times, commands - desired(times), velocity - desired(times[0], 1)))


def corrected(
    arm: ArmModel,
    desired: Trajectory,
    sent: Trajectory,
    estimate: Callable[[SE3], SE3],
    limits: MotionLimits,
    until_s: float | None = None,
) -> Trajectory:
    """Return commands that change from the ``sent`` ones to those that follow ``desired``, on the same time.

    They begin like the sent ones, in position, velocity and acceleration, and reach the correction as soon as the
    limits allow, at the latest at the end of the motion. If the limits do not allow the whole correction by then, they
    reach the largest share of it that one of the ramps allows (up to a stop: the last ramp); the rest is left for the
    next correction. Other arguments are those of ``commands_for``.

    Raises:
        OutOfReach: a command would leave a joint's range.
    """
    times = _moments(desired)
    followed = _followed(arm, desired, times, estimate, sent(times[0]), until_s)
    wanted = _inside(arm, followed, clamps=until_s is not None) - sent(times)
    fine = _where_it_peaks(times, sent)
    left_s = float(times[-1] - times[0])
    best, change, least = -1.0, wanted, LEAST_PUSH if until_s is None else 0.0
    for over_s in (*(s for s in RAMPS_S if s < left_s), left_s):
        ramp = wanted * _ramp(times, over_s)[:, None]
        moved = _spline(times, ramp, np.zeros(6))
        share = min(
            _largest_share(sent(fine, order), moved(fine, order), KEPT_SHARE * most, least * most)
            for order, most in ((1, limits.velocity), (2, limits.acceleration))
        )
        if share > best or until_s is not None:
            best, change = share, share * ramp
        if share == 1.0:
            break
    return sent.plus(_spline(times, change, np.zeros(6)))


def _where_it_peaks(times: NDArray[np.float64], sent: Trajectory) -> NDArray[np.float64]:
    """Return the times between which the accelerations of a spline at ``times`` and of the sent motion are linear."""
    breaks = np.union1d(times, sent.times_s[(sent.times_s > times[0]) & (sent.times_s < times[-1])])
    return np.union1d(breaks[:-1], np.nextafter(breaks[1:], -np.inf))


def _largest_share(
    still: NDArray[np.float64], moved: NDArray[np.float64], most: NDArray[np.float64], least: NDArray[np.float64]
) -> float:
    """Return the largest share in [0, 1] with ``|still + share moved| <= most`` where ``moved`` exceeds ``least``."""
    room = most - np.sign(moved) * still
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(np.abs(moved) > least + 1e-9, room / np.abs(moved), 1.0)
    return float(np.clip(shares.min(), 0.0, 1.0))


def _moments(desired: Trajectory) -> NDArray[np.float64]:
    count = max(6, int(np.ceil(desired.duration_s / STEP_S)))
    return np.linspace(desired.times_s[0], desired.times_s[-1], count + 1)


def _ramp(times: NDArray[np.float64], over_s: float | None = None) -> NDArray[np.float64]:
    """Return a ramp from 0 to 1 over these times, or faster, without jumps of velocity or acceleration."""
    x = np.minimum((times - times[0]) / (over_s or times[-1] - times[0]), 1.0)
    return x**3 * (10 - 15 * x + 6 * x * x)


def _followed(
    arm: ArmModel,
    desired: Trajectory,
    times: NDArray[np.float64],
    estimate: Callable[[SE3], SE3],
    q_sent: NDArray[np.float64],
    until_s: float | None,
) -> NDArray[np.float64]:
    """Return commands (n, 6) for a motion at these times; after ``until_s`` their correction soon becomes constant."""
    q = desired(times)
    if until_s is None:
        return _commands(arm, q, estimate, q_sent)
    near = max(2, int(np.searchsorted(times, until_s, side="right")))
    try:
        commands = _commands(arm, q[:near], estimate, q_sent)
    except OutOfReach:  # the present correction is still added
        return q + (q_sent - q[0])
    if near >= len(times):
        return commands
    added = commands[-2:] - q[near - 2 : near]
    rate = (added[1] - added[0]) / (times[near - 1] - times[near - 2])
    later = 1 - np.exp(-(times[near:, None] - times[near - 1]) / FADE_S)
    return np.concatenate([commands, q[near:] + added[1] + FADE_S * rate * later])


def _commands(
    arm: ArmModel, q: NDArray[np.float64], estimate: Callable[[SE3], SE3], q_sent: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joints (n, 6) to be commanded for estimated ones (n, 6), whether within the joints' ranges or not.

    The correction is computed at some of them, each starting from the previous one's, and interpolated.
    """
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(fk(arm, q).translation_m, axis=0), axis=-1)))
    count = max(4, int(np.ceil(way[-1] / NODE_M)) + 1)
    near = np.searchsorted(way, np.linspace(0.0, way[-1], count)).clip(0, len(way) - 1)
    nodes = np.unique(np.concatenate([[0], near, [len(way) - 1]]))
    nodes = nodes[np.diff(way[nodes], prepend=-1.0) > APART_M]
    found, added = [], q_sent - q[0]
    for node in nodes:
        added = _added(arm, q[node], estimate, added)
        found.append(added)
    if len(nodes) == 1:
        return q + found[0]
    spline = make_interp_spline(way[nodes], np.array(found), k=min(3, len(nodes) - 1))
    return q + spline(np.minimum(way, way[nodes[-1]]))


def _added(
    arm: ArmModel, q_wanted: NDArray[np.float64], estimate: Callable[[SE3], SE3], added: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the correction (6,) that a command adds to the wanted joints, starting from a guess."""
    # The iteration compares joints, where the errors arise. With poses, whose errors rotate with the gripper, it need
    # not converge.
    for _ in range(ROUNDS):
        added = added + q_wanted - ik_near(arm, estimate(fk(arm, q_wanted + added)), q_wanted)
    return added


def _inside(arm: ArmModel, q: NDArray[np.float64], clamps: bool = False) -> NDArray[np.float64]:
    """Return commands (..., 6) kept inside the joints' range; refuse those far outside unless it ``clamps``."""
    short = SHORT * (arm.upper - arm.lower)
    kept = np.clip(q, arm.lower + short, arm.upper - short)
    beyond = np.abs(q - kept) - short - LITTLE
    if (beyond > 0).any() and not clamps:
        joint = int(np.argmax(np.max(np.atleast_2d(beyond), axis=0)))
        raise OutOfReach(
            f"a command would leave the range of joint {arm.joints[joint].name!r}, "
            f"{arm.lower[joint]:.3f} to {arm.upper[joint]:.3f}; choose another place, or turn the gripper differently"
        )
    return kept


def _spline(times: NDArray[np.float64], q: NDArray[np.float64], velocity: NDArray[np.float64]) -> Trajectory:
    """Return the cubic spline through joints, from a velocity to rest."""
    spline = CubicSpline(times, q, bc_type=((1, velocity), (1, np.zeros(6))))  # type: ignore[arg-type]
    return Trajectory(spline.x, spline.c)


def command_for(
    arm: ArmModel, T_wanted: SE3, estimate: Callable[[SE3], SE3], reference: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joints (6,) to be commanded so that the tip comes to rest at one pose in the base.

    Raises:
        OutOfReach: they would leave a joint's range.
    """
    q_wanted = ik_near(arm, T_wanted, reference)
    guess = reference - ik_near(arm, estimate(fk(arm, reference)), reference)
    return _inside(arm, q_wanted + _added(arm, q_wanted, estimate, guess))
