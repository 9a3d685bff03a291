"""What a person is told of a motion before saying yes."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from driven import ARM, HOME, PAPER
from trocar.arms import fk
from trocar.cell import GoalOffer
from trocar.console.question import Question
from trocar.geometry import SE3
from trocar.motion import rest_to_rest

GOAL = HOME + np.array([0.4, 0.3, -0.05, 0.8, 0.5, -0.6])
MOTION = rest_to_rest(HOME, GOAL, PAPER)
BASES = {"a": SE3.identity(), "b": SE3.from_parts(translation_m=[0.08, 0.0, 0.0])}


def about(motions, moving=False, arms=("a", "b")):
    robot = SimpleNamespace(
        setpoint=lambda arm: SimpleNamespace(q=HOME, moving=moving and arm == "b"),
        read=lambda arm: SimpleNamespace(jaw_rad=0.3),
    )
    cell = SimpleNamespace(arms=dict.fromkeys(arms, ARM), T_world_base_registered=BASES, robot=robot)
    return Question.about(cell, motions)


def test_it_says_how_far_how_long_and_where_to():
    question = about({"a": MOTION}, arms=("a",))
    tips_m = fk(ARM, MOTION.sample(1e-3)[1]).translation_m
    far, lasts, *end = map(
        float, re.match(r"a moves (\S+) cm in (\S+) s, to (\S+) (\S+) (\S+) mm$", question.words).groups()
    )
    assert far == pytest.approx(100 * np.linalg.norm(np.diff(tips_m, axis=0), axis=1).sum(), abs=0.06)
    assert lasts == pytest.approx(MOTION.duration_s, abs=0.05)
    np.testing.assert_allclose(end, 1e3 * tips_m[-1], atol=0.51)
    np.testing.assert_allclose(question.ghosts["a"].path_m[-1], tips_m[-1], atol=1e-9)
    np.testing.assert_allclose(question.ghosts["a"].q, GOAL, atol=1e-9)
    assert question.ghosts["a"].jaw_rad == 0.3


def test_it_says_how_near_the_arms_come():
    """The instruments are 80 mm apart at the tips to begin with; bodies have a radius, so they are nearer than axes."""
    apart_mm = float(re.search(r"arms stay (\S+) mm apart", about({"a": MOTION}).words).group(1))
    tips_m = fk(ARM, MOTION.sample(1e-3)[1]).translation_m
    other_m = (BASES["b"] @ fk(ARM, HOME)).translation_m
    assert 0 < apart_mm < 1e3 * np.linalg.norm(tips_m - other_m, axis=1).min()
    both = about({"a": MOTION, "b": MOTION}).words
    assert float(re.search(r"arms stay (\S+) mm apart", both).group(1)) > apart_mm, "they move alike"


def test_it_says_nothing_of_that_while_the_other_arm_moves():
    assert "apart" not in about({"a": MOTION}, moving=True).words


def test_a_goal_between_two_places_is_drawn_over_what_stands_between_them():
    robot = SimpleNamespace(setpoint=lambda arm: SimpleNamespace(q=HOME), read=lambda arm: SimpleNamespace(jaw_rad=0.3))
    cell = SimpleNamespace(arms={"a": ARM}, T_world_base_registered=BASES, robot=robot)
    ends_m = np.array([[0.1, 0.2, 0.01], [0.16, 0.2, 0.03]])
    path_m = Question.of(cell, [GoalOffer("a", "takes it", ends_m)]).ghosts["a"].path_m
    np.testing.assert_allclose(path_m[[0, -1]], ends_m)
    assert path_m[len(path_m) // 2, 2] == pytest.approx(0.02 + 0.05) and (np.diff(path_m[:, 0]) > 0).all()
