import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits
from trocar.motion import limit_use
from trocar.motion.limits import CHECK_STEP_S, hulls, knot_jumps
from trocar.trajectory import Trajectory

ARM = ARMS["psm-classic"]
LIMITS = MOTION_LIMITS["paper"]


def test_ratios_of_a_cubic_known_in_closed_form():
    step, t = np.array([0.3, 0, 0, 0, 0, 0]), 0.8
    trajectory = Trajectory.hermite([0, t], ARM.middle + np.outer([0, 1], step), np.zeros((2, 6)))
    use = limit_use(ARM, trajectory, LIMITS)
    assert use.velocity_ratio == pytest.approx(1.5 * 0.3 / t / LIMITS.velocity[0], rel=1e-12)
    assert use.acceleration_ratio == pytest.approx(6 * 0.3 / t**2 / LIMITS.acceleration[0], rel=1e-12)
    assert not use.range_excess.any()


def test_both_sides_of_a_knot_are_seen():
    """The acceleration before a knot is the largest here, and no sample on the right of any knot shows it."""
    coefficients = np.zeros((3, 2, 6))
    coefficients[2] = ARM.middle
    jerky = np.zeros((4, 2, 6))
    jerky[1:] = coefficients
    jerky[0, 0, 0] = 1.0  # q = t^3 on the first piece, so 6 t of acceleration just before its end
    use = limit_use(ARM, Trajectory(np.array([0, 0.10005, 0.5]), jerky), MotionLimits(np.ones(6), np.ones(6)))
    assert use.acceleration_ratio == pytest.approx(6 * 0.10005, rel=1e-12)


def test_range_is_checked_between_knots():
    q = np.tile(ARM.middle, (2, 1))
    q[:, 2] = ARM.upper[2] - 0.001
    velocity = np.zeros((2, 6))
    velocity[:, 2] = 0.2, -0.2
    use = limit_use(ARM, Trajectory.hermite([0, 0.4], q, velocity), LIMITS)
    assert use.range_excess[2] == pytest.approx(0.2 * 0.4 / 4 - 0.001, abs=1e-9)
    assert not use.kept


@pytest.mark.parametrize("seconds", [2.01, 2.03, 4.06])  # where steps of 1 ms reach the end by rounding
def test_every_duration_can_be_checked(seconds):
    q = ARM.middle + np.outer([0, 1], [0.3, 0, 0, 0, 0, 0])
    use = limit_use(ARM, Trajectory.hermite([0, seconds], q, np.zeros((2, 6))), LIMITS)
    assert use.velocity_ratio == pytest.approx(1.5 * 0.3 / seconds / LIMITS.velocity[0], rel=1e-6)


def test_each_joint_is_told_by_itself():
    q = ARM.middle + np.outer([0, 1], [0.3, 0, 0, 0.1, 0, 0])
    use = limit_use(ARM, Trajectory.hermite([0, 0.8], q, np.zeros((2, 6))), LIMITS)
    np.testing.assert_allclose(use.acceleration, 6 * np.array([0.3, 0, 0, 0.1, 0, 0]) / 0.64 / LIMITS.acceleration)
    assert use.jerk_ratio == 0  # none is limited


def jerked(coefficients, seconds, jerk=10.0):
    limits = MotionLimits(np.full(6, 1e3), np.full(6, 1e3), jerk=np.full(6, jerk))
    pieces = np.zeros((len(coefficients), len(coefficients[0]), 6))
    pieces[..., 0] = coefficients
    pieces[-1] += ARM.middle
    return limit_use(ARM, Trajectory(np.array(seconds), pieces), limits).jerk_ratio


def test_jerk_and_jumps_of_the_acceleration():
    # 0 to 1 with no velocity and no acceleration at both ends: 10 t^3 - 15 t^4 + 6 t^5, jerk 60 at both ends
    smooth = np.array([6.0, -15.0, 10.0, 0.0, 0.0, 0.0])[:, None] / 10
    assert jerked(smooth, [0.0, 1.0]) == pytest.approx(0.6)
    assert jerked([[0.5], [0.0], [0.0]], [0.0, 1.0]) == np.inf  # starts with an acceleration
    assert jerked([[-1 / 6], [0.5], [0.0], [0.0]], [0.0, 1.0]) == np.inf
    # t^3 / 6, then 1/2 tau^2 and so on: the acceleration is the same before and after, or not
    assert jerked([[1 / 6, 0.0], [0.0, 0.5], [0.0, 0.5], [0.0, 1 / 6]], [0.0, 1.0, 1.1]) == np.inf  # at the end
    assert not np.isinf(
        jerked([[1 / 6, -1 / 6, 0.0], [0, 0.5, 0.0], [0, 0.5, 1.0], [0, 1 / 6, 1.0]], [0.0, 1.0, 2.0, 3.0])
    )
    assert np.isinf(jerked([[1 / 6, -1 / 6, 0.0], [0, 0.4, 0.0], [0, 0.5, 1.0], [0, 1 / 6, 1.0]], [0.0, 1.0, 2.0, 3.0]))


def test_what_a_motion_under_way_accelerates_with_at_its_start_is_nobodys_jump():
    assert jerked([[-1 / 6], [0.5], [-0.5], [0.0]], [0.0, 1.0]) == pytest.approx(0.1)
    assert jerked([[-1 / 6], [0.5], [0.0], [0.0]], [0.0, 1.0]) == np.inf  # from rest


def test_jumps_at_knots():
    pieces = np.zeros((2, 2, 6))
    pieces[0, :, 1], pieces[1, 1, 1] = (1.0, 3.0), 1.5  # t, then 1.5 + 3 t from t = 1
    trajectory = Trajectory(np.array([0.0, 1.0, 2.0]), pieces)
    np.testing.assert_allclose(knot_jumps(trajectory, 0), np.array([[0, 0.5, 0, 0, 0, 0]]).T)
    np.testing.assert_allclose(knot_jumps(trajectory, 1), np.array([[0, 2, 0, 0, 0, 0]]).T)


@pytest.mark.parametrize("seed", range(12))
def test_pieces_that_are_left_out_hide_no_extreme(seed):
    """Many pieces of any degree: the shares are those of all samples at 1 kHz and of both sides of all knots."""
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.3, rng.integers(1, 30)))])
    motion = Trajectory(times, rng.normal(size=(rng.integers(1, 8), len(times) - 1, 6)))
    limits = MotionLimits(LIMITS.velocity, LIMITS.acceleration)
    use = limit_use(ARM, motion, limits)
    grid = np.arange(0.0, times[-1], CHECK_STEP_S)
    samples = np.concatenate([grid, times[:-1], np.nextafter(times[1:], 0.0)])
    for name, order in (("velocity", 1), ("acceleration", 2)):
        share = np.abs(motion(samples, order)).max(axis=0) / getattr(limits, name)
        np.testing.assert_allclose(getattr(use, name), share, rtol=1e-9, atol=1e-9)
    q = motion(samples)
    excess = np.maximum(0.0, np.maximum(ARM.lower - q.min(axis=0), q.max(axis=0) - ARM.upper))
    np.testing.assert_allclose(use.range_excess, excess, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("order", range(5))
def test_a_derivative_stays_in_its_hull(order):
    rng = np.random.default_rng(order)
    motion = Trajectory(np.array([0.0, 0.4, 1.0]), rng.normal(size=(4, 2, 3)))
    hull = hulls(motion, order)
    for piece, (begin, end) in enumerate([(0.0, 0.4), (0.4, 1.0)]):
        values = motion(np.linspace(begin, np.nextafter(end, 0), 200), order)
        assert np.all(values <= hull[:, piece].max(axis=0) + 1e-12)
        assert np.all(values >= hull[:, piece].min(axis=0) - 1e-12)
