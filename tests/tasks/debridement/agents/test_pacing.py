"""The pace of a motion whose commands need more acceleration than the motion itself."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from trocar.arms import MotionLimits, fk
from trocar.lab import load_station
from trocar.motion import limit_use, rest_to_rest
from trocar.tasks.debridement.agents.pacing import KEPT_SHARE, paced
from trocar.trajectory import Trajectory

LEFT = load_station("raven-pair").arms["left"]
ARM, LIMITS, START = LEFT.model, LEFT.limits, LEFT.park_q()
DESIRED = rest_to_rest(START, START + [0.4, -0.1, -0.04, 0.2, -0.3, 0.1], LIMITS.scaled(0.85))
WAVE = np.array([0.0, 0.0, 0.012, 0.1, 0.0, 0.0])
"""What commands add to the motion in its middle: more of the instrument's insertion and roll than of other joints."""


def bent(desired, waves=1.5, size=1.0):
    """Return commands that leave and come back to the motion, this many times."""
    times = np.linspace(*desired.times_s[[0, -1]], 41)
    share = np.linspace(0.0, 1.0, 41)[:, None]
    wave = np.sin(2 * np.pi * waves * share) * np.sin(np.pi * share) ** 2 * WAVE * size
    spline = CubicSpline(times, wave, bc_type="clamped")
    return desired.plus(Trajectory(spline.x, spline.c))


def tip_speed_m_s(motion):
    times = np.arange(*motion.times_s[[0, -1]], 0.005)
    return np.linalg.norm(np.diff(fk(ARM, motion(times)).translation_m, axis=0), axis=1) / 0.005


def test_commands_that_exceed_the_limits_are_slowed_down_only_where_they_do():
    commands = bent(DESIRED)
    stretch = limit_use(ARM, commands, LIMITS).acceleration_ratio ** 0.5
    assert stretch > 1.4, "a guard would slow all of it down by this"
    motion, sent, _ = paced(ARM, DESIRED, commands, LIMITS)
    assert limit_use(ARM, sent, LIMITS).acceleration_ratio <= KEPT_SHARE + 1e-6
    assert limit_use(ARM, sent, LIMITS).velocity_ratio <= KEPT_SHARE + 1e-6
    assert motion.duration_s == sent.duration_s < 0.97 * stretch * DESIRED.duration_s
    assert tip_speed_m_s(motion).max() < 1.02 * tip_speed_m_s(DESIRED).max()


def test_the_tip_is_as_fast_as_planned_even_if_its_commands_lead_further():
    steady = MotionLimits(0.1 * LIMITS.velocity, 0.85 * LIMITS.acceleration)
    desired = rest_to_rest(START, START + [0.6, -0.1, -0.02, 0.2, -0.3, 0.1], steady)
    commands = Trajectory(desired.times_s, 1.3 * desired.coefficients)
    commands.coefficients[-1] -= 0.3 * START
    assert limit_use(ARM, commands, LIMITS).acceleration_ratio > 1.0
    motion, sent, _ = paced(ARM, desired, commands, LIMITS)
    assert tip_speed_m_s(sent).max() > 1.2 * tip_speed_m_s(desired).max()
    assert 0.97 < tip_speed_m_s(motion).max() / tip_speed_m_s(desired).max() < 1.02
    assert motion.duration_s < 1.1 * desired.duration_s


def test_both_stay_on_their_paths_and_pass_corresponding_places_at_the_same_time():
    commands = bent(DESIRED)
    motion, sent, times = paced(ARM, DESIRED, commands, LIMITS)
    assert (np.diff(times, axis=0) > 0).all() and motion.times_s[0] == sent.times_s[0] == 0.0
    new = np.linspace(0.0, sent.duration_s, 200)
    old = np.interp(new, times[:, 1], times[:, 0])
    for found, before in ((motion, DESIRED), (sent, commands)):
        tips_m = [fk(ARM, q).translation_m for q in (found(new), before(old))]
        assert np.linalg.norm(tips_m[0] - tips_m[1], axis=1).max() < 5e-4
    for found, before in ((motion, DESIRED), (sent, commands)):
        ends = found.times_s[[0, -1]]
        np.testing.assert_allclose(found(ends), before(before.times_s[[0, -1]]), atol=1e-9)
        np.testing.assert_allclose(found(ends - [0, 1e-9], 1), 0.0, atol=1e-6)


def test_commands_within_the_limits_stay_as_they_are():
    commands = bent(DESIRED, size=0.02)
    motion, sent, times = paced(ARM, DESIRED, commands, LIMITS)
    assert motion is DESIRED and sent is commands
    assert np.interp(0.7, *times.T) == pytest.approx(0.7)


def test_an_arm_that_first_waits_for_the_other_one_waits_as_long():
    wait = Trajectory(np.array([0.0, 0.8]), DESIRED(0.0)[None, None])
    waiting = wait.then(DESIRED)
    later = Trajectory(np.array([0.0, 0.8]), bent(DESIRED)(0.0)[None, None]).then(bent(DESIRED))
    motion, sent, times = paced(ARM, waiting, later, LIMITS)
    for found in (motion, sent):
        assert np.abs(found(0.75) - found(0.0)).max() < 1e-4
        assert np.abs(found(1.2) - found(0.0)).max() > 1e-2
    assert times[:2] == pytest.approx(np.array([[0.0, 0.0], [0.8, 0.8]]), abs=0.03)


def test_tighter_limits_take_longer():
    slow = MotionLimits(LIMITS.velocity, 0.5 * LIMITS.acceleration)
    times_s = [paced(ARM, DESIRED, bent(DESIRED), limits)[0].duration_s for limits in (LIMITS, slow)]
    assert times_s[1] > 1.2 * times_s[0]
