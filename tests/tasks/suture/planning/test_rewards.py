from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import jacobian
from trocar.errors import TrocarError
from trocar.tasks.suture.demonstrations import Demonstrations
from trocar.tasks.suture.planning import MARGINS, PRESETS, Reward, dexterity
from trocar.tasks.suture.planning.rewards import SURROGATE, surrogate_manipulability

LIMIT = np.radians([260.0, 80.0, 80.0])


def margin(name, *degrees):
    return MARGINS[name](LIMIT, np.radians(degrees))


def test_the_printed_formula_rewards_what_lies_beyond_a_limit():
    assert margin("paper", 250.0, 80.0, 80.0) == pytest.approx(100.0)
    assert margin("paper", 260.0, 80.0, 100.0) == pytest.approx(400.0)


def test_the_other_formulas_do_not():
    assert margin("clipped", 260.0, 80.0, 100.0) == 0.0
    assert margin("clipped", 250.0, 76.0, 100.0) == pytest.approx(116.0)
    assert margin("normalised", 130.0, 40.0, 90.0) == pytest.approx(0.5)
    assert margin("smallest", 130.0, 60.0, 20.0) == pytest.approx(0.25)
    assert margin("smallest", 130.0, 60.0, 100.0) == pytest.approx(-0.25)


def test_the_surrogate_is_the_mean_of_det_JJT():
    joints = dexterity(PRESETS["default"].setup, positions=8).joints
    J = jacobian(joints.arm, joints.q)
    squared = np.linalg.det(J @ np.swapaxes(J, -1, -2))
    np.testing.assert_allclose(surrogate_manipulability(joints), squared.mean((0, 2)), rtol=1e-9)


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
    recorded = Demonstrations(places, squares, "sixteen sutures")
    given = dexterity(setup, Reward(weight=0.0), 8, recorded)
    assert given.source == given.at([0.1]).source == "sixteen sutures"
    np.testing.assert_allclose(given.best, np.array([8, 7, 6, 5, 4, 5, 6, 7]) / 8)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"margin": "best"}, "choose one of smallest, normalised, clipped, paper"),
        ({"weight": 1.2}, "lambda is 1.2; give 0 to 1"),
        ({"weight": float("nan")}, "give 0 to 1"),
        ({"at": "ends"}, "choose one of stations, path"),
    ],
)
def test_bad_options_are_named(options, says):
    with pytest.raises(TrocarError, match=says):
        Reward(**options)
