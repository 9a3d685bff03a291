"""Commands that bring the tip where it should be, whatever the kinematics say."""

import numpy as np
import pytest

from trocar.arms import MotionLimits, fk, ik_unbounded
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.lab import load_station
from trocar.motion import rest_to_rest
from trocar.tasks.debridement.agents.inverse_control import KEPT_SHARE, command_for, commands_for, corrected
from trocar.trajectory import Trajectory

LEFT = load_station("raven-pair").arms["left"]
ARM, START = LEFT.model, LEFT.park_q()
END = START + [0.10, -0.08, -0.03, 0.2, -0.1, 0.15]
SHARE = 0.75
LIMITS = MotionLimits(SHARE * ARM.motion_limits.velocity, SHARE * ARM.motion_limits.acceleration)
OFF = np.array([0.012, -0.007, 0.009])


def off_by(shift_m, slope=0.1, turn=(0.05, -0.04, 0.08)):
    """An arm whose tip is off by a shift, a turn, and a part that grows with the place."""
    middle = fk(ARM, START).translation_m

    def settled(T):
        p = T.translation_m + shift_m + slope * (T.translation_m - middle)[..., [1, 2, 0]]
        return SE3.from_parts(SO3.exp(np.array(turn)) @ T.rotation, p)

    return settled


def commands(settled, desired):
    sent = command_for(ARM, fk(ARM, START), settled, START)
    return commands_for(ARM, desired, settled, q_start=sent, velocity=np.zeros(6)), sent


def test_the_tip_follows_what_is_desired_where_the_error_is_known():
    settled, desired = off_by(OFF), rest_to_rest(START, END, LIMITS)
    found, sent = commands(settled, desired)
    times = np.linspace(desired.times_s[0], desired.times_s[-1], 60)
    reached, wanted = settled(fk(ARM, found(times))), fk(ARM, desired(times))
    np.testing.assert_allclose(found(times[0]), sent, atol=1e-12)
    assert np.linalg.norm(reached.translation_m - wanted.translation_m, axis=-1).max() < 5e-4
    assert (
        np.linalg.norm(fk(ARM, desired(times)).translation_m - fk(ARM, found(times)).translation_m, axis=-1).min()
        > 5e-3
    )


def test_a_wrist_that_errs_by_tens_of_degrees_is_commanded_all_the_same():
    """Joints off by what was seen in a trial, a part of it growing with the place: in poses the search went astray."""
    off = np.array([0.137, 0.038, -0.035, -0.447, -0.193, 0.046])
    slope = 0.3 * np.array([[0.4, -0.9, 0, 0, 0, 0], [1, -0.5, 0, 0, 0, 0], [0] * 6, [0, -0.8, 0, 0, 0.3, 0]])

    def settled(T):
        q = ik_unbounded(ARM, T)
        error = off + np.concatenate([slope @ (q - START), [0.0, 0.0]])
        return fk(ARM, q + error)

    wanted = fk(ARM, END)
    reached = settled(fk(ARM, command_for(ARM, wanted, settled, START)))
    assert np.linalg.norm(reached.translation_m - wanted.translation_m) < 3e-4
    assert (reached.rotation @ wanted.rotation.inverse()).angle() < 0.01


def test_what_is_added_does_not_swing_where_the_motion_starts_to_brake():
    # accelerations of the motion jump; a spline through its samples would overshoot them by a quarter
    settled, desired = off_by(OFF, slope=0.0, turn=(0, 0, 0)), rest_to_rest(START, END, LIMITS)
    found, _ = commands(settled, desired)
    times = np.linspace(desired.times_s[0], desired.times_s[-1], 2000)[:-1]
    most = np.abs(found(times, 2) / ARM.motion_limits.acceleration).max()
    assert most < 1.15 * np.abs(desired(times, 2) / ARM.motion_limits.acceleration).max()


def test_a_correction_is_made_early_if_limits_allow_and_keeps_them():
    before, after, desired = off_by(OFF), off_by(OFF + [0.003, 0.0, 0.0]), rest_to_rest(START, END, LIMITS)
    sent, _ = commands(before, desired)
    times = np.linspace(desired.times_s[0], desired.times_s[-1], 400)
    limits = MotionLimits(4 * ARM.motion_limits.velocity, 4 * ARM.motion_limits.acceleration)
    found = corrected(ARM, desired, sent, after, limits)
    off = np.linalg.norm(after(fk(ARM, found(times))).translation_m - fk(ARM, desired(times)).translation_m, axis=-1)
    assert off[0] == pytest.approx(0.003, rel=0.05)
    assert off[times > 0.7].max() < 5e-4  # long before the end
    np.testing.assert_allclose(found(times[0], 1), sent(times[0], 1), atol=1e-9)
    assert (np.abs(found(times[:-1], 2)) <= limits.acceleration).all()


def test_an_arm_that_no_command_would_bring_where_it_is_believed_to_be_still_leaves_from_there():
    edge = START.copy()
    edge[0] = ARM.upper[0] - 0.02
    inwards = edge + [-0.4, 0.0, 0.0, 0.0, 0.0, 0.0]

    def astray(T):  # the arm is believed to be turned about its first axis by .1 rad: less than it is commanded
        return SE3.from_parts(SO3.axis("z", -0.1)) @ T

    desired = rest_to_rest(edge, inwards, LIMITS)
    found = commands_for(ARM, desired, astray, q_start=edge, velocity=np.zeros(6))
    times = np.linspace(desired.times_s[0], desired.times_s[-1], 200)
    assert (found(times)[:, 0] < ARM.upper[0]).all()
    np.testing.assert_allclose(found(times[0]), edge, atol=1e-12)
    reached = astray(fk(ARM, found(times[-1]))).translation_m
    np.testing.assert_allclose(reached, fk(ARM, inwards).translation_m, atol=2e-4)
    with pytest.raises(OutOfReach, match="shoulder"):  # but it cannot go where no command leads
        commands_for(ARM, rest_to_rest(inwards, edge, LIMITS), astray, q_start=inwards, velocity=np.zeros(6))


def test_a_correction_that_is_too_much_for_the_limits_is_made_in_part():
    before, after, desired = off_by(OFF), off_by(-OFF), rest_to_rest(START, END, LIMITS)
    sent, _ = commands(before, desired)
    times = np.union1d(np.linspace(desired.times_s[0], desired.times_s[-1], 400), sent.times_s)[:-1]
    most = np.abs(sent(times, 2)).max(axis=0) / KEPT_SHARE * 1.05
    found = corrected(ARM, desired, sent, after, MotionLimits(ARM.motion_limits.velocity, most))
    assert (np.abs(found(times, 2)) <= most * KEPT_SHARE * 1.0001).all()
    shift_m = np.linalg.norm(fk(ARM, found(times[-1])).translation_m - fk(ARM, sent(times[-1])).translation_m)
    assert 1e-4 < shift_m < 2 * np.linalg.norm(OFF)


def test_what_is_expected_beyond_the_next_stop_plays_no_part():
    desired = rest_to_rest(START, END, LIMITS)
    times = np.linspace(desired.times_s[0], desired.times_s[-1], 400)
    places = fk(ARM, desired(times)).translation_m
    until = int(np.flatnonzero(np.linalg.norm(places - places[0], axis=-1) > 0.008)[0])
    way = (places[until] - places[0]) / np.linalg.norm(places[until] - places[0])
    aside = 0.015 * np.cross(way, [0.0, 0.0, 1.0])

    def settled(T):
        """Off by one shift up to the stop, by three times that further on, as nobody knows yet."""
        far = ((T.translation_m - places[until]) @ way)[..., None] > 0.002
        return SE3.from_parts(T.rotation, T.translation_m + np.where(far, 3 * aside, aside))

    constant = off_by(aside, 0.0, (0, 0, 0))
    rest = {"q_start": command_for(ARM, fk(ARM, START), constant, START), "velocity": np.zeros(6)}
    found = commands_for(ARM, desired, settled, **rest, until_s=float(times[until]))
    known = commands_for(ARM, desired, constant, **rest)
    # nor does what is added jump at the stop: a spline through a jump would swing before it
    np.testing.assert_allclose(found(times[:until]), known(times[:until]), atol=1e-3)


def test_commands_up_to_a_stop_stay_at_the_end_of_a_joints_range_where_others_are_refused():
    edge = START.copy()
    edge[4] = ARM.upper[4] - 0.02
    desired = rest_to_rest(START, edge, LIMITS)
    settled = off_by(np.zeros(3), 0.0, (0.0, -0.25, 0.25))
    rest = {"q_start": START, "velocity": np.zeros(6)}
    with pytest.raises(OutOfReach, match="would leave the range of joint"):
        commands_for(ARM, desired, settled, **rest)
    found = commands_for(ARM, desired, settled, **rest, until_s=np.inf)
    q = found(np.linspace(desired.times_s[0], desired.times_s[-1], 200))
    assert (q < ARM.upper + 1e-3).all()
    assert (q > ARM.lower - 1e-3).all()
    assert q[-1, 4] > ARM.upper[4] - 0.05


def test_a_correction_is_made_where_the_motion_leaves_room_for_it():
    """A motion that brakes as fast as it may: a correction over all of it, which would brake then too, does not fit."""
    limits = MotionLimits(0.1 * ARM.motion_limits.velocity, KEPT_SHARE * ARM.motion_limits.acceleration)
    whole = rest_to_rest(START, START + [0.4, 0, 0, 0, 0, 0], limits)
    braking = np.flatnonzero(whole(whole.times_s[:-1] + 1e-6, 2)[:, 0] < -0.5)[0]
    steady = Trajectory(whole.times_s[braking - 1 :], whole.coefficients[:, braking - 1 :])
    assert steady.times_s[1] - steady.times_s[0] > 0.9, "first it goes on at one speed"

    def behind(T):
        return fk(ARM, ik_unbounded(ARM, T) - [0.05, 0, 0, 0, 0, 0])

    found = corrected(ARM, steady, steady, behind, ARM.motion_limits)
    end = steady.times_s[-1]
    np.testing.assert_allclose(found(end) - steady(end), [0.05, 0, 0, 0, 0, 0], atol=1e-4)
