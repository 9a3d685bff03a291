import numpy as np
import pytest

from trocar.motion.convex.curve import curve_of

CURVE = curve_of(5)
CONTROL = np.random.default_rng(0).normal(size=(8, 2))


def test_it_starts_and_ends_at_its_outer_control_points():
    assert CURVE.controls == 8
    np.testing.assert_allclose(CURVE.basis(np.array([0.0, 1.0])) @ CONTROL, CONTROL[[0, -1]])
    np.testing.assert_allclose(CURVE.knots, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert CURVE.places[0] == 0.0 and CURVE.places[-1] == 1.0


@pytest.mark.parametrize("order", range(4))
def test_its_pieces_are_those_of_the_basis(order):
    shares = np.linspace(0.0, 1.0, 42)[:-1]
    path = CURVE.path(CONTROL)
    assert path.coefficients.shape == (4, 5, 2)
    np.testing.assert_allclose(path(shares, order), CURVE.basis(shares, order) @ CONTROL, atol=1e-9 * 10**order)


def test_its_energy_is_the_integral_of_speed_and_bending():
    """Squared first derivative and a hundredth of the squared second one, summed over 20,000 midpoints."""
    middles = (np.arange(20000) + 0.5) / 20000
    first, second = (CURVE.path(CONTROL)(middles, order) for order in (1, 2))
    wanted = (first**2 + 0.01 * second**2).mean(axis=0)
    np.testing.assert_allclose(np.einsum("cj,cd,dj->j", CONTROL, CURVE.energy, CONTROL), wanted, rtol=1e-5)


def test_places_inside_are_even_and_leave_out_both_ends():
    np.testing.assert_allclose(CURVE.inner(2), np.arange(1, 10) / 10)
    np.testing.assert_allclose(curve_of(2).inner(3), np.arange(1, 6) / 6)


def test_a_line_of_control_points_goes_from_one_place_to_the_other():
    line = CURVE.line(np.array([1.0, 2.0]), np.array([3.0, -4.0]))
    np.testing.assert_allclose(CURVE.path(line)(np.array([0.0, 0.25, 1.0])), [[1, 2], [1.5, 0.5], [3, -4]], atol=1e-12)
