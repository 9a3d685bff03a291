from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import jacobian
from trocar.errors import TrocarError
from trocar.tasks.suture.demonstrations import Demonstrations
from trocar.tasks.suture.planning import MARGINS, PRESETS, Reward, dexterity, suture_joints, with_settings
from trocar.tasks.suture.planning.rewards import SURROGATE
from trocar.tasks.suture.planning.setup import mirrored

LIMIT = np.radians([260.0, 80.0, 80.0])


def margin(name, *degrees, weights=(1.0, 1.0, 1.0)):
    return MARGINS[name](LIMIT, np.radians(degrees), np.array(weights))


def test_the_printed_formula_rewards_what_lies_beyond_a_limit():
    assert margin("paper", 250.0, 80.0, 80.0) == pytest.approx(100.0)
    assert margin("paper", 260.0, 80.0, 100.0) == pytest.approx(400.0)


def test_the_other_formulas_do_not():
    assert margin("clipped", 260.0, 80.0, 100.0) == 0.0
    assert margin("clipped", 250.0, 76.0, 100.0) == pytest.approx(116.0)
    assert margin("normalised", 130.0, 40.0, 90.0) == pytest.approx(0.5)
    assert margin("smallest", 130.0, 60.0, 20.0) == pytest.approx(0.25)
    assert margin("smallest", 130.0, 60.0, 100.0) == pytest.approx(-0.25)


def test_joints_of_more_weight_count_more_and_those_of_none_do_not():
    assert margin("clipped", 250.0, 76.0, 70.0, weights=(1, 2, 0)) == pytest.approx(100.0 + 2 * 16.0)
    assert margin("paper", 250.0, 76.0, 70.0, weights=(0, 1, 3)) == pytest.approx(16.0 + 3 * 100.0)
    assert margin("normalised", 130.0, 40.0, 40.0, weights=(1, 2, 3)) == pytest.approx(0.25 * 6)
    assert margin("smallest", 130.0, 60.0, 60.0, weights=(1, 0, 1)) == pytest.approx(0.25)
    assert margin("smallest", 130.0, 60.0, 20.0, weights=(4, 1, 1)) == pytest.approx(0.125)


def test_the_surrogate_is_the_mean_of_det_JJT_over_both_arms_in_the_directions_that_each_can_drive():
    setup = PRESETS["default"].setup
    joints = dexterity(setup, positions=72).joints
    arms = [joints, suture_joints(mirrored(setup), joints.thetas_rad)]
    expected = []
    for arm in arms:
        J = jacobian(arm.arm, arm.q)
        squared = np.linalg.det(J @ np.swapaxes(J, -1, -2)).mean(2)
        assert not arm.feasible.all() and arm.feasible.any(0).all()
        expected.append([values[can].mean() for values, can in zip(squared.T, arm.feasible.T, strict=True)])
    found = dexterity(setup, positions=72)
    np.testing.assert_allclose(found.by_arm, expected, rtol=1e-9)
    np.testing.assert_allclose(found.manipulability, np.mean(expected, 0), rtol=1e-9)


@pytest.mark.parametrize("name", MARGINS)
def test_both_parts_reach_one_at_their_best(name):
    setup = PRESETS["paper-demo"].setup
    for weight in (0.0, 1.0):
        found = dexterity(setup, Reward(name, weight), positions=72)
        assert found.best.max() == pytest.approx(1.0)


def test_lambda_weighs_the_two_parts():
    setup, reward = PRESETS["default"].setup, Reward()
    one, other, mixed = (dexterity(setup, replace(reward, weight=w), 36).values for w in (1.0, 0.0, 0.3))
    np.testing.assert_allclose(mixed, 0.3 * one + 0.7 * other, atol=1e-12)


def test_the_better_margin_decides_unless_only_one_direction_is_possible():
    setup = PRESETS["paper-demo"].setup
    found = dexterity(setup, Reward("paper"), 360)
    both = found.joints.feasible.all(0)
    assert both.any()
    np.testing.assert_array_equal(found.choice[both], np.argmax(found.margin[:, both], 0))
    one = found.joints.feasible.any(0) & ~both
    assert found.feasible[one].all()


def test_given_manipulability_takes_the_surrogates_place_and_is_named():
    setup = PRESETS["default"].setup
    assert dexterity(setup, positions=8).source == SURROGATE
    places, squares = np.radians([0.0, 90.0, 180.0, 270.0]), np.array([[3.0, 2.0, 1.0, 2.0], [5.0, 4.0, 3.0, 4.0]])
    recorded = Demonstrations(places, squares, "sixteen sutures", np.array([0.0, 1.0, 2.0, 1.0]))
    given = dexterity(setup, Reward(weight=0.0), 8, recorded)
    assert given.source == given.at([0.1]).source == "sixteen sutures"
    np.testing.assert_allclose(given.best, np.array([8, 7, 6, 5, 4, 5, 6, 7]) / 8)
    cautious = dexterity(setup, Reward(weight=0.0, caution=0.5), 8, recorded)
    means, sds = np.array([4, 3.5, 3, 2.5, 2, 2.5, 3, 3.5]), np.array([0, 0.5, 1, 1.5, 2, 1.5, 1, 0.5])
    np.testing.assert_allclose(cautious.manipulability, means - 0.5 * sds)
    with pytest.raises(TrocarError, match="a caution needs the variance of recorded sutures"):
        dexterity(setup, Reward(caution=1.0), 8)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"margin": "best"}, "choose one of smallest, normalised, clipped, paper"),
        ({"weight": 1.2}, "lambda is 1.2; give 0 to 1"),
        ({"weight": float("nan")}, "give 0 to 1"),
        ({"at": "ends"}, "choose one of stations, path"),
        ({"joint_weights": (1.0, -1.0, 1.0)}, "the joints' weights is 1, -1, 1; give three"),
        ({"joint_weights": (0.0, 0.0, 0.0)}, "not all 0"),
        ({"caution": -1.0}, "the caution is -1; give 0 standard deviations or more"),
    ],
)
def test_bad_options_are_named(options, says):
    with pytest.raises(TrocarError, match=says):
        Reward(**options)


def test_a_second_arm_changes_what_is_feasible_and_no_rewards():
    alone = dexterity(PRESETS["default"].setup)
    paired = dexterity(with_settings(PRESETS["default"], {"puller_up_mm": 100}).setup)
    np.testing.assert_array_equal(paired.values, alone.values)
    assert (alone.joints.feasible & ~paired.joints.feasible).any() and paired.feasible.all()


def test_the_span_of_rewards_leaves_out_sutures_that_no_joints_can_make():
    found = dexterity(PRESETS["default"].setup, positions=36)
    feasible = found.values[found.joints.feasible]
    assert found.span(np.array([-680.0])) == (feasible.min(), feasible.max())
    found.joints.feasible[:] = False
    assert found.span(np.array([-680.0, 0.25, 0.5])) == (0.25, 0.5)
    assert found.span(np.array([-680.0])) == (0.0, 1.0)
