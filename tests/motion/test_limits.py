import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits
from trocar.errors import TrocarError
from trocar.motion import limit_use
from trocar.motion.limits import CHECK_STEP_S, LimitUse, hulls, knot_jumps, require_range
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
    jerky = limit_use(ARM, trajectory, MotionLimits(LIMITS.velocity, LIMITS.acceleration, np.full(6, 1e3)))
    assert jerky.velocity_ratio == use.velocity_ratio and jerky.acceleration_ratio == use.acceleration_ratio


@pytest.mark.parametrize("seconds", [2.01, 2.03, 4.06])  # where steps of 1 ms reach the end by rounding
def test_every_duration_can_be_checked(seconds):
    q = ARM.middle + np.outer([0, 1], [0.3, 0, 0, 0, 0, 0])
    use = limit_use(ARM, Trajectory.hermite([0, seconds], q, np.zeros((2, 6))), LIMITS)
    assert use.velocity_ratio == pytest.approx(1.5 * 0.3 / seconds / LIMITS.velocity[0], rel=1e-6)


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


@pytest.mark.parametrize(("off", "jumps"), [(0.9e-6, False), (1.1e-6, True)])
def test_an_acceleration_jumps_by_more_than_a_millionth_of_its_limit(off, jumps):
    a = off * 1e3  # of the limit in `jerked`
    falling, rising = [[-a / 6], [a / 2], [0], [0]], [[a / 6], [0], [0], [0]]
    assert np.isinf(jerked(falling, [0.0, 1.0])) == jumps  # out of a rest
    assert np.isinf(jerked(rising, [0.0, 1.0])) == jumps  # into the rest
    assert not np.isinf(jerked([[-a / 6], [a / 2], [0.1], [0]], [0.0, 1.0]))  # it is under way
    between = [[1 / 6, -1 / 6], [0, 0.5 + a / 2], [0, 0.5], [0, 1 / 6]]  # from a velocity, an acceleration of 0 to 1
    assert np.isinf(jerked(between, [0.0, 1.0, 2.0])) == jumps


def test_all_ratios_and_ranges_must_be_kept():
    share = np.ones(6)
    ones = dict.fromkeys(("velocity", "acceleration", "jerk"), share)
    for ratio, kept in ((1.0, True), (1 + 0.9e-9, True), (1 + 1.1e-9, False), (2.0, False)):
        for name in ones:
            use = LimitUse(**ones | {name: np.array([0, ratio, 0.5, 0, 0, 0])}, range_excess=np.zeros(6))
            assert use.kept == kept and getattr(use, f"{name}_ratio") == ratio
    assert not LimitUse(share, share, share, range_excess=1e-12 * np.eye(6)[3]).kept


@pytest.mark.parametrize(("joint", "sign"), [(2, 1.0), (3, -1.0)])
def test_a_range_may_not_be_left(joint, sign):
    q = np.tile(ARM.middle, (2, 1))
    q[1, joint] = (ARM.upper if sign > 0 else ARM.lower)[joint]
    require_range(ARM, limit_use(ARM, Trajectory.hermite([0.0, 1.0], q, np.zeros((2, 6))), LIMITS))
    q[1, joint] += sign * 1e-6
    with pytest.raises(TrocarError, match=f"takes joint '{ARM.joints[joint].name}' 0.000001 .* out of its range"):
        require_range(ARM, limit_use(ARM, Trajectory.hermite([0.0, 1.0], q, np.zeros((2, 6))), LIMITS))


def test_a_motion_whose_times_do_not_start_at_nothing_is_measured_too():
    q = ARM.middle + np.outer([0, 1], [0.3, 0, 0, 0, 0, 0])
    late, early = (Trajectory.hermite([t, t + 0.8], q, np.zeros((2, 6))) for t in (5.0, 0.0))
    one, other = (limit_use(ARM, motion, LIMITS) for motion in (late, early))
    np.testing.assert_allclose(one.velocity, other.velocity, rtol=1e-6)
    np.testing.assert_allclose(one.acceleration, other.acceleration)


@pytest.mark.parametrize("order", range(4))
def test_a_hull_is_made_of_bernsteins_coefficients(order):
    """Of t^3 on [0, 2]: the values of its polar form, 0 0 0 8, and those of its derivatives."""
    motion = Trajectory(np.array([0.0, 2.0]), np.array([1.0, 0, 0, 0])[:, None, None])
    wanted = [[0, 0, 0, 8], [0, 0, 12], [0, 12], [6]][order]
    np.testing.assert_allclose(hulls(motion, order)[:, 0, 0], wanted, atol=1e-12)
    assert not hulls(motion, 4).any()
