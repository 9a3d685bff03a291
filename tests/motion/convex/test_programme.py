import numpy as np
import pytest

from trocar.motion.convex import programme as module
from trocar.motion.convex.curve import curve_of
from trocar.motion.convex.programme import Programme
from trocar.motion.convex.rows import Rows

CURVE = curve_of(5)
JOINTS = 12


def programme(held=()):
    weights = np.tile([1.0, 1.0, 100.0, 1.0, 1.0, 1.0], 2)
    none = np.zeros((0, CURVE.controls))
    return Programme(CURVE, weights, tuple(held) or (none, none))


def some_rows(rng, count=12):
    shares = rng.uniform(0.2, 0.8, count)
    return Rows(rng.uniform(-0.01, 0.02, count), 0.1 * rng.normal(size=(count, JOINTS)), CURVE.basis(shares))


def cost(asked, control, rows, change, price, damping):
    count = CURVE.controls
    near = damping / count * (asked.weights * change**2).sum() / 2
    return asked.energy(control + change) + near + price * np.maximum(0, -rows.after(change)).sum()


@pytest.mark.parametrize(("price", "damping"), [(1.0, 0.0), (100.0, 0.0), (100.0, 5.0), (1e4, 0.0)])
def test_a_step_is_the_least_of_what_it_costs(price, damping):
    """No change nearby, nor any of many random ones, costs less: the programme is convex."""
    rng = np.random.default_rng(0)
    asked = programme()
    control = CURVE.line(np.zeros(JOINTS), rng.normal(size=JOINTS) * 0.3)
    control[1:-1] += 0.02 * rng.normal(size=(CURVE.controls - 2, JOINTS))
    rows = some_rows(rng)
    change = asked.step(control, rows, price, damping)
    least = cost(asked, control, rows, change, price, damping)
    assert least < cost(asked, control, rows, 0 * change, price, damping)
    for size in (1e-4, 1e-3, 1e-2, 0.1):
        for _ in range(200):
            aside = size * rng.normal(size=change.shape)
            aside[[0, -1]] = 0.0
            assert cost(asked, control, rows, change + aside, price, damping) >= least * (1 - 1e-6)


def test_a_price_that_is_high_enough_keeps_rows_that_can_be_kept():
    rng = np.random.default_rng(1)
    control = CURVE.line(np.zeros(JOINTS), np.full(JOINTS, 0.2))
    rows = some_rows(rng, 6)
    assert rows.room.min() < -1e-3
    change = programme().step(control, rows, 1e6, 0.0)
    assert rows.after(change).min() > -1e-5


def test_ends_and_waypoints_stay_where_they_are():
    rng = np.random.default_rng(2)
    held = CURVE.basis(np.array([0.4])), np.zeros((0, CURVE.controls))
    control = CURVE.line(np.zeros(JOINTS), np.full(JOINTS, 0.2))
    change = programme(held).step(control, some_rows(rng), 100.0, 0.0)
    np.testing.assert_allclose(change[[0, -1]], 0, atol=1e-12)
    moved = CURVE.basis(np.array([0.4])) @ change
    np.testing.assert_allclose(moved[:, :6], 0, atol=1e-12)
    assert np.abs(moved[:, 6:]).max() > 1e-4


def test_more_damping_makes_smaller_steps():
    control, rows = CURVE.line(np.zeros(JOINTS), np.full(JOINTS, 0.2)), some_rows(np.random.default_rng(3))
    sizes = [np.linalg.norm(programme().step(control, rows, 100.0, damping)) for damping in (0.0, 10.0, 1e3)]
    assert sizes[0] > sizes[1] > sizes[2] > 0


def test_what_is_free_is_weighed_by_its_energy_and_the_damping():
    """Against the equations of the least: energy and damping on inner control points, waypoints held by multipliers."""
    held = CURVE.basis(np.array([0.3, 0.6]))
    asked = programme([held, np.zeros((0, CURVE.controls))])
    rng = np.random.default_rng(4)
    control = rng.normal(size=(CURVE.controls, JOINTS))
    nothing = Rows(np.zeros(0), np.zeros((0, JOINTS)), np.zeros((0, CURVE.controls)))
    for damping in (0.0, 3.0):
        change = asked.step(control, nothing, 1.0, damping)
        for k, rows in enumerate((held, held[:0])):
            fixed = np.vstack([rows, np.eye(CURVE.controls)[[0, -1]]])
            matrix = CURVE.energy + damping * np.eye(CURVE.controls) / CURVE.controls
            zero = np.zeros((len(fixed), len(fixed)))
            whole = np.block([[matrix, fixed.T], [fixed, zero]])
            right = np.vstack([-CURVE.energy @ control, np.zeros((len(fixed), JOINTS))])
            wanted = np.linalg.solve(whole, right)[: CURVE.controls]
            columns = slice(6 * k, 6 * k + 6)
            np.testing.assert_allclose(change[:, columns], wanted[:, columns], atol=1e-8)
        assert asked.inverses(damping) is asked.inverses(damping)


def test_energy_is_half_the_weighed_squares_and_rows_that_are_kept_change_nothing():
    asked = programme()
    control = np.zeros((CURVE.controls, JOINTS))
    control[:, 2] = CURVE.places
    assert asked.energy(control) == pytest.approx(100.0 / 2)  # unit speed of a joint that weighs 100
    control[:, 0] = 2 * CURVE.places
    assert asked.energy(control) == pytest.approx(50.0 + 4 / 2)
    rows = some_rows(np.random.default_rng(5))
    far = Rows(rows.room + 10.0, rows.slope, rows.basis)
    nothing = Rows(np.zeros(0), np.zeros((0, JOINTS)), np.zeros((0, CURVE.controls)))
    np.testing.assert_array_equal(asked.step(control, far, 9.0, 0.0), asked.step(control, nothing, 9.0, 0.0))


def test_more_broken_rows_than_are_added_at_a_time_are_all_kept():
    rng = np.random.default_rng(6)
    control = CURVE.line(np.zeros(JOINTS), np.full(JOINTS, 0.2))
    basis = CURVE.basis(np.full(100, 0.5))
    slope = np.zeros((100, JOINTS))
    slope[:, 0] = 0.1
    rows = Rows(-rng.uniform(0.001, 0.01, 100), slope, basis)  # the same joint at the same place, by so much
    change = programme().step(control, rows, 1e6, 0.0)
    assert rows.after(change).min() == pytest.approx(0.0, abs=1e-5)
    assert rows.after(change).max() < 0.01


def test_prices_are_between_nothing_and_the_greatest():
    """x gram x / 2 - missing x with a diagonal: missing / gram, cut off at 0 and at the price."""
    found = module._bounded_least(np.diag([2.0, 4.0, 0.5, 0.1]), np.array([1.0, -3.0, 8.0, 0.1]), 5.0)
    np.testing.assert_allclose(found, [0.5, 0.0, 5.0, 1.0], atol=1e-5)
    gram = np.array([[2.0, 1.0], [1.0, 3.0]])
    np.testing.assert_allclose(module._bounded_least(gram, gram @ [0.5, 0.7], 9.0), [0.5, 0.7], atol=1e-6)
