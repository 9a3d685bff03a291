import numpy as np
import pytest

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
