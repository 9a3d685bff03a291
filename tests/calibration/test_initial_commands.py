"""What is asked for, and the sketch of its commands."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from plant_models import FAR, HOME, RESTING, TRAINING, plant_model
from trocar.arms import MOTION_LIMITS, MotionLimits
from trocar.calibration import command_path
from trocar.calibration.command_path import CommandRequest, knots_of, sketched
from trocar.calibration.compensation import HysteresisState
from trocar.calibration.models import OffsetModel, RidgeModel
from trocar.calibration.plant import PSM1_GREY
from trocar.errors import TrocarError
from trocar.motion import rest_to_rest
from trocar.motion.double_integrator import shortest_to_rest_s
from trocar.trajectory import Trajectory

PAPER = MOTION_LIMITS["paper"]
GOOD = {"q_start": np.zeros(6), "velocity_start": np.zeros(6), "lower": -np.ones(6), "upper": np.ones(6)}


def made(**changes):
    return CommandRequest(memory=None, desired=None, limits=PAPER, **(GOOD | changes))


@pytest.mark.parametrize("name", GOOD)
def test_a_request_holds_six_finite_numbers_each(name):
    assert made(**{name: [0.0] * 6}).__getattribute__(name).dtype == np.float64
    for wrong in (np.zeros(5), np.zeros((1, 6)), [0.0, 0.0, np.nan, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, np.inf]):
        with pytest.raises(TrocarError, match=f"{name} of a request must "):
            made(**{name: wrong})


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_commands_may_run_at_their_limit_and_no_faster(joint, sign):
    """A rounding above it is let through."""
    full = sign * PAPER.velocity * (np.arange(6) == joint)
    for share in (0.99, 1.0, 1.0 + 1e-7):
        assert made(velocity_start=share * full).velocity_start[joint] == share * full[joint]
    with pytest.raises(TrocarError, match=rf"joint {joint + 1} has commands that already run at 1\.01 times"):
        made(velocity_start=1.01 * full)
    with pytest.raises(TrocarError, match=rf"joint {joint + 1} "):
        made(velocity_start=(1.0 + 1e-5) * full)


OFF = np.array([0.001, -0.002, 0.0005, 0.1, -0.05, 0.08])
OFFSET = OffsetModel(OFF, TRAINING)


PLAY = plant_model(PSM1_GREY)


def request(desired, model=PLAY, q_start=HOME, velocity=RESTING, **changes):
    made = CommandRequest(
        HysteresisState.at_rest(model, q_start), desired, q_start, velocity, PAPER, np.full(6, -5.0), np.full(6, 5.0)
    )
    return replace(made, **changes)


# Knots.


def test_a_short_motion_has_a_dozen_intervals_and_a_long_one_no_wider_than_a_fortieth_of_a_second():
    for duration, spacing in ((0.012, 0.001), (0.12, 0.010), (0.24, 0.010), (0.48, 0.010), (0.96, 0.020), (4.8, 0.025)):
        knots = knots_of(Trajectory.hermite([0.0, duration], [HOME, FAR], np.zeros((2, 6))))
        assert_allclose(np.diff(knots), spacing, rtol=1e-9)
        assert knots[0] == 0.0 and knots[-1] == duration


def test_knots_are_where_a_motion_has_its_own_unless_they_are_too_near():
    """A spacing of .02; corners nearer than half of it to the one before or to the end are left out."""
    times = np.array([0.0, 0.009, 0.0105, 0.0204, 0.0206, 0.5, 0.9495, 0.9505, 0.96])
    q = np.linspace(0, 1, len(times))[:, None] * np.ones(6)
    knots = knots_of(Trajectory.hermite(times, q, np.zeros_like(q)))
    kept = [0.0, 0.0105, 0.0206, 0.5, 0.9495, 0.96]
    assert [np.abs(knots - corner).min() < 1e-12 for corner in kept] == [True] * 6
    for left_out in (0.009, 0.0204, 0.9505):
        assert np.abs(knots - left_out).min() > 1e-5
    steps = np.diff(knots)
    assert steps.max() <= 0.02 + 1e-12 and steps.min() >= 0.01 - 1e-9
    assert len(knots) == 1 + 1 + 1 + 24 + 23 + 1


def test_a_corner_half_a_spacing_from_the_last_is_kept():
    times = np.array([0.0, 0.01 + 1e-9, 0.95 - 1e-9, 0.96])
    knots = knots_of(Trajectory.hermite(times, np.zeros((4, 6)), np.zeros((4, 6))))
    assert_allclose(knots[[1, -2]], times[1:3])


# The sketch.


def followed(sketch, model=PLAY, q_start=HOME):
    """Return the joints after the sketch's commands, one after the other, and what was desired there."""
    desired = sketch.request.desired(sketch.shares * sketch.request.desired.duration_s)
    memory = HysteresisState.at_rest(model, q_start)
    return memory.along(desired + sketch.correction)[1:], desired[1:]


def test_commands_of_a_sketch_bring_the_joints_where_they_should_be():
    desired = rest_to_rest(HOME + PSM1_GREY_OFFSET, FAR, PAPER)
    sketch = sketched(request(desired))
    joints, wanted = followed(sketch)
    assert_allclose(joints, wanted, atol=1.5e-3)
    assert_allclose(wanted[-1], FAR)
    assert_allclose(sketch.end, FAR + sketch.correction[-1])
    assert_allclose(sketch.correction[0], HOME - desired.q[0])
    assert not sketch.given_up.any()
    assert sketch.shares[0] == 0.0 and sketch.shares[-1] == 1.0


PSM1_GREY_OFFSET = PLAY.step(PLAY.start(HOME), HOME)[0] - HOME


def test_a_sketch_has_a_point_each_sixty_milliseconds_and_four_at_least():
    for duration, points in ((0.1, 4), (0.24, 4), (0.25, 5), (0.6, 10), (0.61, 11)):
        sketch = sketched(request(Trajectory.hermite([0.0, duration], [HOME, HOME + 0.01], np.zeros((2, 6)))))
        assert len(sketch.shares) == points + 1
        assert_allclose(np.diff(sketch.shares), 1 / points)


def test_models_with_a_window_are_asked_as_densely_as_they_were_trained():
    """One and a half radians of roll in steps of a twentieth, for which the clock's own points are too few."""
    rng = np.random.default_rng(0)
    ridge = RidgeModel(rng.normal(0, 0.01, (36, 6)), OFF, TRAINING)
    sketch = sketched(request(rest_to_rest(HOME + OFF, HOME + OFF + [0, 0, 0, 1.5, 0, 0], PAPER), ridge))
    desired = sketch.request.desired
    steps = np.diff(desired(sketch.shares * desired.duration_s)[:, 3])
    assert steps.max() <= 0.055 and np.median(steps) > 0.03
    joints, wanted = followed(sketch, ridge)
    assert_allclose(joints, wanted, atol=0.01)


def test_the_last_error_is_the_first_guess(monkeypatch):
    guesses = []

    def inverse(model, state, q, guess, tolerance_rad):
        guesses.append(guess - (q - OFF))
        return q - OFF

    monkeypatch.setattr(command_path, "inverse", inverse)
    sketched(request(rest_to_rest(HOME, FAR, PAPER), OFFSET, HOME - OFF))
    assert len(guesses) > 4
    assert_allclose(guesses, 0.0, atol=1e-12)


def test_rows_between_points_are_interpolated():
    sketch = sketched(request(rest_to_rest(HOME, FAR, PAPER)))
    rows = np.arange(6.0 * len(sketch.shares)).reshape(-1, 6) ** 1.5
    middle = (sketch.shares[2] + sketch.shares[3]) / 2
    assert_allclose(sketch.at(np.array([0.0, middle, 1.0]), rows), [rows[0], (rows[2] + rows[3]) / 2, rows[-1]])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_a_range_forbids_is_given_up_by_that_joint_alone(side):
    """Pitch may go no further than the joint does; its cable asks for more."""
    away = HOME + np.array([0.0, 0.0, 0.0, 0.3, side * 0.4, 0.3])
    desired = rest_to_rest(HOME + PSM1_GREY_OFFSET, away, PAPER)
    free = sketched(request(desired))
    bound = free.end[4] - side * 0.05
    limit = np.where(np.arange(6) == 4, bound, side * 5.0)
    sketch = sketched(request(desired, **{"upper" if side > 0 else "lower": limit}))
    joints, wanted = followed(sketch)
    commands = wanted + sketch.correction[1:]
    reached = sketch.upper[4] if side > 0 else sketch.lower[4]
    assert commands[-1, 4] == pytest.approx(reached, abs=1e-3)
    assert side * (wanted - joints)[-1, 4] > 0.01
    assert_allclose(joints[:, [0, 1, 2, 3, 5]], wanted[:, [0, 1, 2, 3, 5]], atol=1.5e-3)
    assert_allclose(sketch.farthest[4], free.farthest[4], atol=0.02)
    # What is given up is what the joints would have had by the commands without a range.
    assert_allclose((wanted - joints)[:, 4], sketch.given_up[1:, 4], atol=3e-3)
    assert not sketch.given_up[0].any() and np.abs(sketch.given_up[-1, 4]) > 0.01


def test_the_farthest_command_is_towards_or_beyond_the_end_that_is_nearer():
    """Of the asked motion, not of the brake after it."""
    middle = HOME + [0, 0, 0, 0.5, 0.3, -0.4]
    desired = Trajectory.hermite([0.0, 0.8, 1.6], [HOME, middle, HOME], np.zeros((3, 6)))
    wide = {"lower": HOME - 0.6, "upper": HOME + 0.6}
    sketch = sketched(request(desired, OFFSET, HOME - OFF, **wide))
    assert_allclose(sketch.farthest[3:], (middle - OFF)[3:], atol=0.02)
    moving = Trajectory.hermite([0.0, 1.0], [HOME, middle], np.array([np.zeros(6), [0, 0, 0, 1.0, 0, 0]]))
    sketch = sketched(request(moving, OFFSET, HOME - OFF, **wide))
    assert sketch.request.desired.q[-1, 3] > middle[3] + 0.01
    assert sketch.farthest[3] == pytest.approx((middle - OFF)[3], abs=0.02)


def test_the_start_may_be_the_farthest_command():
    still = Trajectory.hermite([0.0, 1.0], [HOME, HOME], np.zeros((2, 6)))
    off = HOME - OFF + [0, 0, 0, 0.2, -0.3, 0]
    sketch = sketched(request(still, OFFSET, off, lower=HOME - 0.6, upper=HOME + 0.6))
    assert_allclose(sketch.farthest[3:5], off[3:5])
    assert_allclose(sketch.correction[0], off - HOME)
    assert_allclose(sketch.correction[1:, 3], -OFF[3], atol=0.01)


# Ranges.


def test_ranges_reach_to_where_the_joints_and_the_commands_are():
    tight = {"lower": HOME - 0.01, "upper": HOME + 0.01}
    sketch = sketched(request(rest_to_rest(HOME, FAR, PAPER), q_start=HOME + 0.03, **tight))
    taken = np.array([HOME, FAR, HOME + 0.03, HOME - 0.01, HOME + 0.01])
    assert_allclose(sketch.lower, taken.min(axis=0))
    assert_allclose(sketch.upper, taken.max(axis=0))


def test_ranges_reach_to_where_the_joints_go_in_between():
    away = HOME + [0, 0, 0, 0.5, -0.3, 0.4]
    desired = Trajectory.hermite([0.0, 0.8, 1.6], [HOME, away, HOME], np.zeros((3, 6)))
    sketch = sketched(request(desired, lower=HOME, upper=HOME))
    assert_allclose(sketch.lower, np.minimum(HOME, away), atol=1e-3)
    assert_allclose(sketch.upper, np.maximum(HOME, away), atol=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_ranges_reach_to_where_a_moving_command_can_be_braked(side):
    """Its speed squared about twice the acceleration, and a knot's spacing further."""
    velocity = side * np.array([0.1, 0.1, 0.02, 2.0, 1.5, 1.0])
    still = Trajectory.hermite([0.0, 1.0], [HOME, HOME], np.zeros((2, 6)))
    sketch = sketched(request(still, velocity=velocity, lower=HOME, upper=HOME))
    stop = HOME + side * (velocity**2 / (2 * PAPER.acceleration) + 0.025 * np.abs(velocity))
    assert_allclose(sketch.upper if side > 0 else sketch.lower, stop)
    assert_allclose(sketch.lower if side > 0 else sketch.upper, HOME)


# Brakes.


def test_a_motion_that_ends_in_motion_goes_straight_on_until_all_rest_at_once():
    v = np.array([0.0, 0.0, 0.0, 2.0, -1.0, 0.5])
    desired = Trajectory.hermite([0.0, 1.0], [HOME, FAR], np.array([np.zeros(6), v]))
    braked = sketched(request(desired)).request.desired
    longest = np.max(np.abs(v) / PAPER.acceleration)
    assert braked.duration_s == pytest.approx(1.0 + longest)
    assert_allclose(braked(np.array([0.3, 1.0])), desired(np.array([0.3, 1.0])), atol=1e-12)
    for t in (0.2, 0.7, 1.0):  # of the brake
        assert_allclose(braked(1.0 + t * longest), FAR + v * longest * (t - t**2 / 2), atol=1e-9)
    assert_allclose(braked(1.0 + longest * (1 - 1e-9), 1), 0.0, atol=1e-6)


def test_what_can_be_braked_in_no_time_rests():
    for share, brakes in ((0.9, False), (1.1, True)):
        v = share * 1e-4 * PAPER.acceleration * (np.arange(6) == 4)
        desired = Trajectory.hermite([2.0, 3.0], [HOME, FAR], np.array([np.zeros(6), v]))
        braked = sketched(request(desired)).request.desired
        assert braked.times_s[0] == 0.0
        assert (braked.duration_s > 1.0 + 1e-9) == brakes


# Time.


def stretch(desired, q_start, velocity=RESTING, limits=PAPER):
    """Return the least stretch of the way of joints that are their commands."""
    exact = OffsetModel(np.zeros(6), TRAINING)
    return sketched(request(desired, exact, q_start, velocity, limits=limits)).way_stretch()


@pytest.mark.parametrize("joint", [1, 2, 4])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_motion_without_enough_time_gets_it(joint, side):
    """From rest to rest, half the time forward and half back, is the least; knots cost a little."""
    gentle = MotionLimits(np.full(6, 100.0), np.full(6, 4.0))
    away = HOME + side * np.eye(6)[joint]
    least_s = 2 * np.sqrt(1.0 / 4.0)
    for given_s in (0.1, 0.5, 0.9):
        desired = Trajectory.hermite([0.0, given_s], [HOME, away], np.zeros((2, 6)))
        needed = stretch(desired, HOME, limits=gentle) * given_s
        assert least_s * 0.999 < needed < 1.03 * least_s


def test_a_motion_with_time_enough_is_not_slowed_down():
    gentle = MotionLimits(np.full(6, 100.0), np.full(6, 4.0))
    away = HOME + 0.9 * np.eye(6)[3]
    assert stretch(Trajectory.hermite([0.0, 1.05], [HOME, away], np.zeros((2, 6))), HOME, limits=gentle) == 1.0
    assert stretch(Trajectory.hermite([0.0, 9.0], [HOME, away], np.zeros((2, 6))), HOME, limits=gentle) == 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_start_in_motion_counts(side):
    """Against the way it costs time; it must at least be braked."""
    gentle = MotionLimits(np.full(6, 100.0), np.full(6, 4.0))
    axis = np.arange(6) == 3
    for way, speed in ((1.0, -1.0), (0.05, 1.0), (-0.5, 1.0), (0.0, 1.0)):
        goal, velocity = HOME + side * way * axis, side * speed * axis
        desired = Trajectory.hermite([0.0, 0.2], [HOME, goal], np.zeros((2, 6)))
        found = stretch(desired, HOME, velocity, gentle) * 0.2
        exact = shortest_to_rest_s(np.array([side * way]), np.array([side * speed]), np.array([100.0]), np.array([4.0]))
        assert 0.995 * np.max(exact) < found < 1.06 * np.max(exact) + 0.02


def test_a_start_that_cannot_be_braked_in_time_gets_more():
    """Even where full brakes would have the joint at its goal by then, still moving; the other joints rest."""
    push, axis = 4.0 * (1.0 - 2e-7), np.arange(6) == 3
    gentle = MotionLimits(np.full(6, 100.0), np.full(6, 4.0))
    goal = HOME + (0.2 - push * 0.2**2 / 2) * axis
    desired = Trajectory.hermite([0.0, 0.2], [HOME, goal], np.zeros((2, 6)))
    assert stretch(desired, HOME, 1.0 * axis, gentle) * 0.2 > 0.25
