import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.errors import TrocarError
from trocar.trajectory import Trajectory


@given(seed=st.integers(0, 2**32 - 1), knots=st.integers(2, 6))
def test_hermite_meets_positions_and_velocities(seed, knots):
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0], np.cumsum(rng.uniform(0.1, 1, knots - 1))])
    q, v = rng.normal(size=(2, knots, 3))
    trajectory = Trajectory.hermite(times, q, v)
    np.testing.assert_allclose(trajectory(times), q, atol=1e-9)
    np.testing.assert_allclose(trajectory(times, 1), v, atol=1e-8)


def test_derivatives_agree_with_differences_and_it_rests_outside():
    trajectory = Trajectory.hermite([0, 0.5, 1.2], np.array([[0.0], [1], [0.5]]), np.array([[0.0], [1], [0]]))
    t, h = np.linspace(0.1, 1.1, 7) + 1e-3, 1e-6
    for order in (1, 2):
        difference = (trajectory(t + h, order - 1) - trajectory(t - h, order - 1)) / (2 * h)
        np.testing.assert_allclose(trajectory(t, order), difference, atol=1e-6)
    np.testing.assert_allclose(trajectory([-1, 5]), [[0], [0.5]], atol=1e-12)
    assert not trajectory([-1, 5], 1).any()


def test_then_and_sample():
    first = Trajectory.hermite([0, 1], np.array([[0.0], [1]]), np.zeros((2, 1)))
    second = Trajectory(np.array([0, 0.55]), np.array([[[1.0]]]))
    joined = first.then(second)
    assert joined.duration_s == pytest.approx(1.55)
    np.testing.assert_allclose(joined([0.3, 1.2])[:, 0], [first(0.3)[0], 1.0])
    times, q = joined.sample(0.1)
    assert len(times) == 17
    assert np.diff(times).max() <= 0.1
    np.testing.assert_allclose(q[-1], 1.0)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_sum_has_the_derivatives_of_both_across_all_knots(seed):
    rng = np.random.default_rng(seed)
    knots = [np.concatenate([[0.0], np.sort(rng.uniform(0.1, 0.9, 3)), [1.0]]) for _ in range(2)]
    knots[1][2] = knots[0][2] + 1e-12  # the same, but for rounding
    knots[1].sort()
    one, other = (Trajectory(t, rng.normal(size=(k, 4, 2))) for t, k in zip(knots, (4, 2), strict=True))
    both, t = one.plus(other), rng.uniform(0.0, 1.0, 50)
    t = t[np.abs(t[:, None] - np.concatenate(knots)).min(axis=1) > 1e-6]
    for order in range(3):
        np.testing.assert_allclose(both(t, order), one(t, order) + other(t, order), atol=1e-9)


def test_trajectories_over_different_times_do_not_add():
    one, other = (Trajectory(np.array([0.0, end]), np.ones((1, 1, 1))) for end in (1.0, 2.0))
    with pytest.raises(TrocarError, match="do not add"):
        one.plus(other)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Trajectory([0.0, np.inf], np.zeros((1, 1, 6))), "times of a trajectory must be finite"),
        (lambda: Trajectory("now", np.zeros((1, 1, 6))), "times of a trajectory must be numbers"),
        (lambda: Trajectory([0.0, 2.0, 1.0], np.zeros((1, 2, 6))), r"strictly increasing times, got \.\.\., 2, 1 s"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((1, 2, 6))), r"must have shape \(k, 1, joints\), got \(1, 2, 6\)"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((0, 1, 6))), "at least one power and one joint"),
        (lambda: Trajectory.hermite([0.0, 1.0], np.full((2, 6), np.nan), np.zeros((2, 6))), "positions must be finite"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((1, 1, 6))).stretched(np.inf), "give a factor above 0 and below"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((1, 1, 6))).stretched(2**80), "give a factor above 0 and below"),
        (lambda: Trajectory([0.0, 1.0], np.full((2, 1, 1), np.nan)), "finite"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((1, 1, 6))).sample(0), "step"),
        (lambda: Trajectory([0.0, 1.0], np.zeros((1, 1, 6))).sample(1e-12), "give one above 0 that makes fewer than"),
    ],
)
def test_what_is_no_trajectory_is_refused_in_one_sentence(make, words):
    with pytest.raises(TrocarError, match=words) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_a_trajectory_says_how_long_it_is():
    assert repr(Trajectory([0.0, 0.5, 1.25], np.zeros((1, 2, 6)))) == "<Trajectory of 6 joints: 1.250 s in 2 pieces>"
