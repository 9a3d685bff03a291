"""The layer that poses quadratic programs: what is least within named constraints."""

import numpy as np
import pytest
from scipy import sparse

from trocar.errors import NoPlan
from trocar.motion.qp import FREE, Program


def program(size, linear=None, **asked):
    """The least of half the squares plus a linear cost."""
    return Program("it", sparse.csc_matrix(np.eye(size)), np.zeros(size) if linear is None else linear, **asked)


def test_equations_bounds_and_what_is_bounded_by_nothing():
    """With x0 + 1 = 3, x1 - .5 + 2 s >= 2: of x1 + 2 s = 2.5 the nearest to 0."""
    asked = program(3)
    asked.keep("first", sparse.csr_matrix([[1.0, 0.0, 0.0]]), 3.0, 3.0, rest=1.0)
    asked.keep("second", sparse.csr_matrix([[0.0, 1.0, 2.0]]), 2.0, FREE, rest=-0.5)
    asked.keep("none", sparse.csr_matrix([[1.0, 1.0, 0.0], [0.0, 3.0, 0.0]]), -FREE, np.array([5.0, FREE]))
    np.testing.assert_allclose(asked.least(), [2.0, 0.5, 1.0], atol=1e-6)


@pytest.mark.parametrize(("linear", "least"), [(0.0, 1.5), (-9.0, 4.0), (-3.0, 3.0)])
def test_a_row_is_kept_from_both_sides_together_with_what_is_added_to_it(linear, least):
    asked = program(1, np.array([linear]))
    asked.keep("row", sparse.csr_matrix([[2.0]]), 4.0, np.array([9.0]), rest=np.array([1.0]))
    assert asked.least()[0] == pytest.approx(least, abs=1e-6)


@pytest.mark.parametrize("dense", [True, False])
def test_variables_have_bounds_of_their_own(dense):
    hessian = np.diag([2.0, 1.0, 4.0])
    asked = {"lower": 0.0, "upper": np.array([1.0, 2.0, 3.0])}
    found = Program("it", hessian if dense else sparse.csc_matrix(hessian), np.array([-1.0, -9.0, 1.0]), **asked)
    np.testing.assert_allclose(found.least(), [0.5, 2.0, 0.0], atol=1e-6)


def test_what_cannot_be_kept_is_refused_and_named():
    asked = program(1)
    asked.keep("at least", sparse.csr_matrix([[1.0]]), 1.0, FREE)
    asked.keep("at most", sparse.csr_matrix([[1.0]]), -FREE, 0.5)
    with pytest.raises(NoPlan, match="it: none within at least, at most"):
        asked.least()
    reversed_bounds = program(1)
    reversed_bounds.keep("between", sparse.csr_matrix([[1.0]]), 1.0, 0.5)
    with pytest.raises(NoPlan, match="it: none within between"):
        reversed_bounds.least()


def test_the_solver_gives_up_after_its_iterations():
    asked = program(4, np.arange(4.0), lower=-1.0, upper=1.0, iterations=1)
    with pytest.raises(NoPlan, match=r"it: none within its bounds .*MAX_ITER"):
        asked.least()


def test_it_is_solved_whatever_the_order_of_the_entries():
    """The least of the squares about a goal with a sum of at most 1, the Hessian's entries out of order."""
    goal, slope = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, 0.25, 0.0, 1.0])
    mixing = np.array([[2.0, 1, 0, 0], [0, 1, 0, 1], [1, 0, 3, 0], [0, 0, 1, 1]])
    hessian = mixing.T @ mixing
    mixed = sparse.csc_matrix(hessian)
    for column in range(4):  # the same matrix, each column's entries backwards
        part = slice(mixed.indptr[column], mixed.indptr[column + 1])
        mixed.indices[part], mixed.data[part] = mixed.indices[part][::-1].copy(), mixed.data[part][::-1].copy()
    mixed.has_sorted_indices = False
    asked = Program("it", mixed, -hessian @ goal)
    asked.keep("sum", sparse.csr_matrix(slope), -FREE, 1.0)
    toll = (slope @ goal - 1.0) / (slope @ np.linalg.solve(hessian, slope))
    np.testing.assert_allclose(asked.least(), goal - toll * np.linalg.solve(hessian, slope), atol=1e-6)
