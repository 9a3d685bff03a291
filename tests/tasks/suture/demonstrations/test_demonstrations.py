"""Manipulability round the circle is the mean over recordings, linear in between, and periodic."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, RAVEN2_LEFT, jacobian
from trocar.errors import TrocarError
from trocar.tasks.suture.demonstrations import demonstrations_from_joints, synthetic_demonstrations
from trocar.tasks.suture.planning import PRESETS, Reward, dexterity

TWO = (PSM_CLASSIC, RAVEN2_LEFT)


def recorded(rng, rows=5, arms=TWO):
    return np.stack([rng.uniform(arm.lower, arm.upper, (rows, 6)) for arm in arms], 1)


def by_definition(q, arm):
    """Return the mean of |J J^T|, from the determinant of the product (paper, III-D2)."""
    J = jacobian(arm, q)
    return np.linalg.det(J @ np.swapaxes(J, -1, -2)).mean()


def test_at_a_place_it_is_the_mean_of_det_J_JT_with_arms_and_recordings_alike():
    rng = np.random.default_rng(1)
    long, short, other = recorded(rng, 40), recorded(rng, 3), recorded(rng)
    demos = demonstrations_from_joints([0.5, 0.5, 2.0], [long, short, other], TWO, "made up")
    assert_allclose(demos.places_rad, [0.5, 2.0])
    expected = [[(by_definition(long[:, a], arm) + by_definition(short[:, a], arm)) / 2] for a, arm in enumerate(TWO)]
    assert_allclose(demos.per_arm[:, :1], expected, rtol=1e-9)
    of_suture = [np.mean([by_definition(q[:, a], arm) for a, arm in enumerate(TWO)]) for q in (long, short)]
    assert_allclose(demos.sd, [np.std(of_suture, ddof=1), 0.0], rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), places=st.integers(2, 9), turns=st.integers(-3, 3))
def test_in_between_it_is_linear_between_the_two_closest_and_periodic(seed, places, turns):
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(0, 2 * np.pi, places))
    demos = demonstrations_from_joints(rng.permutation(at), [recorded(rng) for _ in at], TWO, "made up")
    assert_allclose(demos.places_rad, at)
    ends = np.append(at, at[0] + 2 * np.pi)
    share = rng.uniform(0, 1, places)
    demos = replace(demos, sd=rng.uniform(0, 1, places))
    inside = (1 - share) * ends[:-1] + share * ends[1:]
    found = [*demos.per_arm_at(inside + 2 * np.pi * turns), demos.sd_at(inside + 2 * np.pi * turns)]
    for at_places, linear in zip([*demos.per_arm, demos.sd], found, strict=True):
        values = np.append(at_places, at_places[0])
        expected = (1 - share) * values[:-1] + share * values[1:]
        assert_allclose(linear, expected, atol=1e-9 * values.max() * (1 + 1 / np.diff(ends).min()))


@pytest.mark.parametrize("same", [[0.0, 2 * np.pi], [0.0, -1e-12], [1.0, 1.0 - 2 * np.pi]])
def test_places_a_whole_turn_apart_are_one(same):
    rng = np.random.default_rng(2)
    demos = demonstrations_from_joints([*same, 2.0], [recorded(rng) for _ in range(3)], TWO, "made up")
    assert len(demos.places_rad) == 2


@pytest.mark.parametrize("thetas", [[], [1.0], [1.0, 1.0]])
def test_one_place_alone_is_refused(thetas):
    rng = np.random.default_rng(3)
    with pytest.raises(TrocarError, match="two or more"):
        demonstrations_from_joints(thetas, [recorded(rng) for _ in thetas], TWO, "made up")


def test_a_plan_takes_manipulability_from_demonstrations():
    demos = synthetic_demonstrations()
    setup = PRESETS["default"].setup
    map = dexterity(setup, recorded=demos)
    assert map.source == demos.source
    assert_allclose(map.manipulability[::45], demos.per_arm.mean(0))
    assert (demos.sd > 0).all()
    cautious = dexterity(setup, Reward(caution=2.0), recorded=demos)
    assert_allclose(cautious.manipulability[::45], np.maximum(demos.per_arm.mean(0) - 2 * demos.sd, 0))
    assert not np.allclose(map.values, dexterity(setup).values, atol=0.02)
