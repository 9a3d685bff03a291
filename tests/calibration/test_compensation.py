import numpy as np
import pytest
from numpy.testing import assert_allclose

from plant_models import recorded
from trocar.arms import ARMS
from trocar.calibration import compensation
from trocar.calibration.compensation import Compensator, algorithm1, inverse, resample, sample_positions
from trocar.calibration.excitation import PSM1_BOX, MotionBox, random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.models.base import TrainingMotion
from trocar.calibration.plant import PLANTS

ARM = next(iter(ARMS.values()))
WASHOUT = 20


def closed_loop(plant, compensator, desired):
    """The plant's true error along a path that starts at rest, without measurement noise."""
    compensator.start(desired[0])
    q_cmd = compensator.path(desired)
    return (plant.run(np.vstack([desired[:1], q_cmd]))[1:] - desired)[WASHOUT:, 3:]


@pytest.fixture(scope="module")
def play():
    plant = PLANTS["psm1_grey"]
    return plant, MODELS["play"].fit(recorded(plant, np.random.default_rng(0), 500), np.random.default_rng(0))


def wider():
    push = np.array([0, 0, 0, 0.3, 0.11, 0.11])
    return MotionBox(PSM1_BOX.lower - push, PSM1_BOX.upper + push, PSM1_BOX.step)


def small():
    lower, upper = np.array([0.7, 0, 0.15, -1.4, -0.1, -0.1]), np.array([0.9, 0.1, 0.2, -1.0, 0.15, 0.15])
    return MotionBox(lower, upper, PSM1_BOX.step / 3)


@pytest.mark.parametrize("box", [PSM1_BOX, wider(), small()], ids=["same", "wider", "small"])
def test_the_exact_inverse_closes_the_loop(play, box):
    plant, model = play
    error = closed_loop(plant, Compensator(model), random_smooth_path(ARM, np.random.default_rng(7), 150, box))
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.006)


def test_algorithm1_halves_the_error_with_any_model():
    plant = PLANTS["psm1_grey"]
    model = MODELS["ridge"].fit(recorded(plant, np.random.default_rng(0), 500), np.random.default_rng(0))
    desired = random_smooth_path(ARM, np.random.default_rng(9), 300)
    after = np.sqrt(np.mean(closed_loop(plant, Compensator(model), desired) ** 2, axis=0))
    before = np.sqrt(np.mean((plant.run(desired) - desired)[WASHOUT:, 3:] ** 2, axis=0))
    assert np.all(after < 0.5 * before)


def test_history_is_carried_from_call_to_call(play):
    _, model = play
    desired = random_smooth_path(ARM, np.random.default_rng(3), 60)
    one, two = Compensator(model), Compensator(model)
    whole = one.path(desired)
    parts = np.vstack([two.path(desired[:25]), two.path(desired[25:])])
    assert_allclose(whole, parts, atol=1e-12)


# Small models, by hand.

TRAINING = TrainingMotion(np.full(6, 0.01), np.zeros(6), np.ones(6), 100)


class Wrist:
    """A model without memory, of errors of the outer joints and any map of the wrist's commands."""

    name, rate_independent, training = "wrist", True, TRAINING

    def __init__(self, function, outer=0.0):
        self.function, self.outer, self.calls = function, outer, 0

    def start(self, q_cmd):
        return None

    def step(self, state, q_cmd):
        return np.concatenate([q_cmd[:3] + self.outer, self.function(q_cmd[3:])]), None

    def linearize(self, state, q_cmd):
        self.calls += 1
        columns = [(self.function(q_cmd[3:] + d) - self.function(q_cmd[3:] - d)) / 2e-7 for d in 1e-7 * np.eye(3)]
        return self.step(state, q_cmd)[0], np.transpose(columns)


OUTER = np.array([0.01, -0.02, 0.003])
BENT = Wrist(lambda w: w + 0.1 * np.sin(3.0 * w[[1, 2, 0]]) + [0.2, -0.1, 0.05], OUTER)
GOAL = np.array([0.5, 0.1, 0.15, 0.3, -0.2, 0.4])


def inverted(model, goal, guess, **tolerance):
    """Return the command for a goal, and where the joints then are."""
    q_cmd = inverse(model, None, goal, guess, **tolerance)
    return q_cmd, model.step(None, q_cmd)[0]


def test_algorithm1_goes_half_of_what_is_left_five_times():
    q = algorithm1(BENT, None, GOAL)
    by_hand = GOAL
    for _ in range(5):
        by_hand = by_hand + 0.5 * (GOAL - BENT.step(None, by_hand)[0])
    assert_allclose(q, by_hand)


def test_the_exact_inverse_of_a_bent_map_is_exact():
    for goal in GOAL * np.array([[1.0], [-1.0], [3.0]]):
        q_cmd, joints = inverted(BENT, goal, goal)
        assert np.linalg.norm((joints - goal)[3:]) < 1e-5
        assert_allclose(q_cmd[:3], goal[:3] - OUTER, atol=1e-12)


def test_the_exact_inverse_stops_once_it_is_near_enough():
    def calls(**tolerance):
        BENT.calls = 0
        _, joints = inverted(BENT, GOAL, GOAL, **tolerance)
        return BENT.calls, np.linalg.norm((joints - GOAL)[3:])

    few, rough = calls(tolerance_rad=1e-2, stalled_rad=1.0)
    many, fine = calls(tolerance_rad=1e-9)
    assert few < many < 12
    assert 1e-5 < rough < 1e-2 and fine < 1e-9


def test_outer_joints_that_hang_on_their_commands_are_inverted_too():
    class Geared(Wrist):
        def step(self, state, q_cmd):
            joints, _ = super().step(state, q_cmd)
            joints[:3] = 1.02 * q_cmd[:3] + OUTER
            return joints, None

    q_cmd, joints = inverted(Geared(BENT.function), GOAL, GOAL)
    assert_allclose(joints[:3], GOAL[:3], atol=1e-4)
    assert_allclose(q_cmd[:3], (GOAL[:3] - OUTER) / 1.02, atol=1e-4)


def stiff(width, at):
    """Return a wrist whose pitch does not follow within a dead zone of this half-width about a command."""

    def joints(w):
        beyond = w[1] - at
        return np.array([w[0], at + np.sign(beyond) * max(abs(beyond) - width, 0.0), w[2]])

    return Wrist(joints)


@pytest.mark.parametrize("width", [0.05, 0.15, 0.3])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_dead_zone_is_left_on_the_side_of_the_goal(width, side):
    """In it the joint ignores its command, so Newton's method alone has nowhere to go."""
    goal = np.array([0, 0, 0, 0.1, side * 0.08, 0.0])
    q_cmd, joints = inverted(stiff(width, 0.0), goal, np.zeros(6))
    assert_allclose(joints[3:], goal[3:], atol=1e-4)
    assert q_cmd[4] == pytest.approx(side * (0.08 + width), abs=1e-3)


def test_where_nothing_reaches_the_goal_the_nearest_is_returned():
    held = Wrist(lambda w: np.array([w[0], np.clip(w[1], -0.1, 0.1), w[2]]))
    goal = np.array([0, 0, 0, 0.2, 0.5, -0.3])
    _, joints = inverted(held, goal, np.zeros(6))
    assert_allclose(joints[3:], [0.2, 0.1, -0.3], atol=1e-3)


def test_a_step_is_never_longer_than_a_backlash():
    """Where a joint follows its command only by a hundredth, a full Newton step would be ten radians."""
    seen = []
    flat = Wrist(lambda w: np.array([w[0], 0.02 * w[1], w[2]]))
    linearize = flat.linearize
    flat.linearize = lambda state, q: (seen.append(q), linearize(state, q))[1]
    goal = np.array([0, 0, 0, 0.0, 0.04, 0.0])
    q_cmd, joints = inverted(flat, goal, np.zeros(6))
    steps = np.abs(np.diff([q[4] for q in seen]))
    assert 0.25 < steps.max() <= 0.3 + 1e-9
    assert q_cmd[4] == pytest.approx(2.0, abs=0.01) and joints[4] == pytest.approx(0.04, abs=2e-4)


def test_a_compensator_starts_where_the_arm_rests_and_remembers_what_was_sent(play):
    _, model = play
    desired = random_smooth_path(ARM, np.random.default_rng(5), 40)
    fresh, started = Compensator(model), Compensator(model)
    started.start(desired[0])
    whole = fresh.path(desired)
    assert_allclose(whole, started.path(desired))
    assert Compensator(model).path(np.empty((0, 6))).shape == fresh.path(np.empty((0, 6))).shape == (0, 6)


def test_a_model_without_a_jacobian_is_inverted_by_algorithm1():
    """Which leaves its known share of a constant offset."""
    offset = MODELS["offset"](np.array([0, 0, 0, 0.26, -0.1, 0.1]), TRAINING)
    left = Compensator(offset).path(GOAL[None]) + offset.offset - GOAL
    assert_allclose(left[0], offset.offset * 0.5**5, atol=1e-15)
    assert_allclose(inverse(offset, None, GOAL, GOAL), GOAL + left[0] - offset.offset)


def test_a_path_is_sampled_as_densely_as_the_joint_that_moves_farthest_needs():
    interval = np.array([0.01, 0.01, 0.002, 0.08, 0.06, 0.0])
    training = TrainingMotion(interval, np.zeros(6), np.ones(6), 100)
    path = np.zeros((5, 6))
    path[1:, 3] = 0.24  # three steps, exactly
    path[2:, 4] = 0.061  # just more than one
    path[3:, 5] = 9.0  # it never moved in training
    assert_allclose(sample_positions(path, training), [0, 1 / 3, 2 / 3, 1, 1.5, 2, 3, 4])
    assert_allclose(resample(path, training)[:, 3], [0, 0.08, 0.16, 0.24, 0.24, 0.24, 0.24, 0.24])
    assert_allclose(resample(path, training)[4, 4], 0.0305)


def test_escapes_go_both_ways_and_farther_each_time():
    sizes = np.abs(compensation.ESCAPES_RAD)
    assert (np.diff(sizes) >= 0).all() and sizes[0] < 0.128 < sizes[-1]


def test_where_errors_stay_the_same_a_command_is_found_at_once():
    """The last error is the first guess: the model is asked there, and no step is needed."""
    model = Wrist(lambda w: w + [0.2, -0.1, 0.05], OUTER)
    compensator = Compensator(model)
    compensator.start(GOAL)
    desired = GOAL + 0.01 * np.arange(4)[:, None]
    q_cmd = compensator.path(desired)
    assert_allclose(q_cmd + np.concatenate([OUTER, [0.2, -0.1, 0.05]]), desired, atol=1e-9)
    assert model.calls == 2 * 4
