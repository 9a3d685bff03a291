import numpy as np
from numpy.testing import assert_allclose

from trocar.calibration.fleet.prior import FEATURES, LoopShape
from trocar.calibration.plant import play_operator

SHAPE = LoopShape(np.array([0.03, 0.1, 0.12]), 0.1, 0.2)


def seen(q):
    """Return what the operators of roll, pitch and yaw see along commands (n, 6)."""
    return [q[:, 3], q[:, 4] + 0.1 * q[:, 5], q[:, 5] + 0.2 * q[:, 4]]


def test_slacks_from_any_start_are_those_of_play_operators():
    q = np.random.default_rng(0).normal(0, 0.2, (40, 6))
    starts = np.array([-1.0, 0.0, 0.5])
    slacks = SHAPE.slacks(q, starts)
    for joint, u in enumerate(seen(q)):
        for s, start in enumerate(starts):
            for k, radius in enumerate(SHAPE.banks[joint]):
                expected = u - play_operator(u, radius, u[0] - start * radius)
                assert_allclose(slacks[:, joint, s, k], expected, atol=1e-12)


def test_features_are_a_constant_the_wrist_and_each_joints_slacks_in_turn():
    q = np.random.default_rng(1).normal(0, 0.2, (20, 6))
    features = SHAPE.features(q)
    assert features.shape == (20, FEATURES) and 4 + SHAPE.banks.size == FEATURES
    slacks = [u - play_operator(u, radius) for joint, u in enumerate(seen(q)) for radius in SHAPE.banks[joint]]
    assert_allclose(features, np.column_stack([np.ones(20), q[:, 3:], *slacks]), atol=1e-12)


def test_operators_lie_on_both_sides_of_the_backlash_and_at_it():
    """A sharp corner is between round ones: of each joint one operator is narrower, one wider by up to twice."""
    narrow, own, wide = (SHAPE.banks / SHAPE.radii[:, None]).T
    assert_allclose(own, 1.0)
    assert (narrow < 0.7).all() and (wide > 1.3).all() and (wide <= 2.0).all()


def test_parameters_and_shape_are_the_same():
    assert_allclose(SHAPE.theta, [np.log(0.03), np.log(0.1), np.log(0.12), 0.1, 0.2])
    again = LoopShape.of(SHAPE.theta)
    assert_allclose([*again.radii, again.a, again.b], [0.03, 0.1, 0.12, 0.1, 0.2])
