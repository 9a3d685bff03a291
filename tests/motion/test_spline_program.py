"""Splines of all joints as rows of a quadratic programme."""

import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import BSpline

from trocar.motion.spline_program import FREE, Block, JointSpline, Rows

SHARES = np.array([0.0, 0.1, 0.35, 0.6, 0.8, 1.0])
AT = np.array([0.0, 0.05, 0.1, 0.4, 0.6, 0.99, 1.0])


def spline(degree=3, held=2, joints=2, seed=0):
    """A spline whose first and last control points are held, some more than others."""
    rng = np.random.default_rng(seed)
    return JointSpline(SHARES, degree, rng.normal(size=(held, joints)), rng.normal(size=(held - 1, joints)))


def curve_of(asked, control):
    knots = np.concatenate([np.zeros(asked.degree), SHARES, np.ones(asked.degree)])
    return BSpline(knots, control, asked.degree)


@pytest.mark.parametrize("degree", [2, 3])
def test_free_control_points_lie_between_those_that_are_held(degree):
    asked = spline(degree)
    assert asked.free == 5 + degree - 3
    free = np.random.default_rng(1).normal(size=2 * asked.free)
    control, line = asked.control(free), asked.control(0 * free)
    assert len(control) == 5 + degree
    np.testing.assert_array_equal(control[:2], asked.first)
    np.testing.assert_array_equal(control[-1:], asked.last)
    np.testing.assert_allclose((control - line)[2:-1], free.reshape(2, -1).T)


@pytest.mark.parametrize("degree", [2, 3])
def test_without_free_parts_it_is_the_straight_line(degree):
    begin, end = np.array([[1.0, -2.0]]), np.array([[2.0, 5.0]])
    asked = JointSpline(SHARES, degree, begin, end)
    line = curve_of(asked, asked.control(np.zeros(2 * asked.free)))
    np.testing.assert_allclose(line(AT), begin + AT[:, None] * (end - begin), atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("degree", [2, 3])
def test_rows_are_the_gradients_times_the_curve(degree, order):
    asked = spline(degree)
    rng = np.random.default_rng(2)
    free, gradient = rng.normal(size=2 * asked.free), rng.normal(size=(len(AT), 2))
    gradient[1] = 0.0
    values = curve_of(asked, asked.control(free))(AT, nu=order)
    basis = asked.basis(AT, order)
    assert basis.weights.shape == (len(AT), degree + 1)
    block = asked.rows(basis, gradient)
    assert np.all(block.data != 0)
    wanted = (gradient * values).sum(axis=1)
    np.testing.assert_allclose(block.matrix(2 * asked.free) @ free + block.rest, wanted, atol=1e-9)
    opposite = -block
    np.testing.assert_allclose(opposite.matrix(2 * asked.free) @ free + opposite.rest, -wanted, atol=1e-9)
    each = asked.each_joint(basis, np.array([2.0, 4.0]))
    scaled = (values / [2.0, 4.0]).T.ravel()
    np.testing.assert_allclose(each.matrix(2 * asked.free) @ free + each.rest, scaled, atol=1e-9)


@pytest.mark.parametrize("degree", [2, 3])
def test_a_motion_is_the_curve_over_so_many_seconds(degree):
    asked = spline(degree)
    control = asked.control(np.random.default_rng(3).normal(size=2 * asked.free))
    motion = asked.trajectory(control, 2.5)
    assert motion.duration_s == 2.5 and len(motion.coefficients) == degree + 1
    for order in range(degree):
        np.testing.assert_allclose(motion(2.5 * AT, order), curve_of(asked, control)(AT, nu=order) / 2.5**order)


def plain(matrix, rest):
    found = sparse.coo_matrix(matrix)
    return Block(found.data, found.row.astype(np.intp), found.col.astype(np.intp), np.asarray(rest, dtype=float))


def test_the_least_within_bounds_with_other_variables_and_what_is_added():
    """x0^2 + x1^2 + s^2 over 2, with x0 + 1 = 3, x1 - .5 + 2 s >= 2, and a row that bounds nothing."""
    rows = Rows(2, 2)
    rows.add(plain([[1.0, 0.0]], [1.0]), 3.0, 3.0)
    rows.add(plain([[0.0, 1.0]], [-0.5]), 2.0, FREE, extra=1, weight=2.0)
    rows.add(plain([[1.0, 1.0], [0.0, 3.0]], [0.0, 0.0]), -FREE, np.array([5.0, FREE]))
    x = rows.least(sparse.csc_matrix(np.eye(4)), np.array([0.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(x, [2.0, 0.5, -1.0, 1.0], atol=1e-5)  # x1 + 2 s = 2.5, the nearest to 0


def test_where_bounds_contradict_there_is_no_answer():
    rows = Rows(1, 0)
    rows.add(plain([[1.0]], [0.0]), 1.0, FREE)
    rows.add(plain([[1.0]], [0.0]), -FREE, 0.5)
    assert rows.least(sparse.csc_matrix(np.eye(1)), np.zeros(1)) is None


def test_without_equations_the_bounds_alone_count():
    rows = Rows(1, 0)
    rows.add(plain([[2.0]], [1.0]), 4.0, 9.0)
    assert rows.least(sparse.csc_matrix(np.eye(1)), np.array([0.0]))[0] == pytest.approx(1.5, abs=1e-5)
    assert rows.least(sparse.csc_matrix(np.eye(1)), np.array([-9.0]))[0] == pytest.approx(4.0, abs=1e-5)
