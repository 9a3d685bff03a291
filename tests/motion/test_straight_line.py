import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from trocar.arms import ARMS, MotionLimits, fk, ik, jacobian
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import limit_use, straight
from trocar.motion import straight_line as module
from trocar.motion.straight_line import PIECES, Sprint, StraightLine, quintics
from waypoints import FOUR, PAPER, PSM


def line_of(begin, end, arm=PSM, limits=PAPER):
    (line,) = StraightLine.between(arm, begin[None], end[None], limits)
    return line


def off_the_line_m(arm, motion, begin, end):
    tips = fk(arm, motion(np.linspace(0, motion.duration_s, int(motion.duration_s * 1e3) + 2))).translation_m
    a, b = fk(arm, begin).translation_m, fk(arm, end).translation_m
    way = (b - a) / np.linalg.norm(b - a)
    gone = tips - a
    return np.linalg.norm(gone - (gone @ way)[:, None] * way, axis=1).max()


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 1), backwards=st.booleans())
def test_the_tip_keeps_to_the_line_within_the_limits_at_1_khz(arm, seed, share, backwards):
    rng = np.random.default_rng(seed)
    begin = arm.middle + rng.uniform(-0.1, 0.1, 6) * (arm.upper - arm.lower)
    tip = fk(arm, begin)
    moved = SE3.from_parts(
        tip.rotation @ SO3.exp(rng.uniform(-0.1, 0.1, 3)), tip.translation_m + rng.uniform(-0.02, 0.02, 3)
    )
    end = ik(arm, moved, begin)
    limits = arm.motion_limits
    line = line_of(begin, end, arm, limits)
    sprint = Sprint.to(line, np.array([share * line.fastest_rate]))
    motion = sprint.trajectory(backwards=backwards)
    assert motion.duration_s == pytest.approx(float(sprint.seconds[0]))
    first, last = (end, begin) if backwards else (begin, end)
    np.testing.assert_allclose(motion(0.0), first, atol=1e-9)
    np.testing.assert_allclose(motion(motion.duration_s), last, atol=1e-9)
    passing = line.slope[-1] * sprint.rates[0] * (-1 if backwards else 1)
    np.testing.assert_allclose(motion(0.0 if backwards else motion.duration_s, 1), passing, atol=1e-8)
    assert off_the_line_m(arm, motion, first, last) < 2e-6
    use = limit_use(arm, motion, limits)
    assert use.velocity_ratio <= 1 + 1e-3 and use.acceleration_ratio <= 1 + 1e-3


def test_a_line_to_rest_is_as_fast_as_the_move_that_follows_it_without_a_bend():
    """Beside `straight`, which follows the same line with one trapezoid for all joints."""
    way_m = fk(PSM, FOUR[1]).translation_m - fk(PSM, FOUR[0]).translation_m
    plain = straight(PSM, FOUR[0], way_m, PAPER)
    seconds = Sprint.to(line_of(FOUR[0], FOUR[1]), np.zeros(1)).seconds[0]
    assert 0.9 * plain.duration_s < seconds <= plain.duration_s * (1 + 1e-6)


def test_one_joint_alone_takes_the_bang_bang_time():
    """The insertion of an arm in its middle moves its tip straight; 2 sqrt(d / a) to rest, sqrt(2 d / a) at speed."""
    begin = np.array([0, 0, 0.15, 0, 0, 0])
    end = begin + [0, 0, 0.03, 0, 0, 0]
    line = line_of(begin, end)
    assert Sprint.to(line, np.zeros(1)).seconds[0] == pytest.approx(2 * np.sqrt(0.03 / 0.4), rel=1e-6)
    assert Sprint.to(line, np.array([line.fastest_rate])).seconds[0] == pytest.approx(np.sqrt(0.06 / 0.4), rel=1e-6)


def test_a_lower_velocity_limit_makes_it_cruise():
    slow = MotionLimits(0.2 * PAPER.velocity, PAPER.acceleration)
    sprint = Sprint.to(line_of(FOUR[0], FOUR[1], limits=slow), np.zeros(1))
    use = limit_use(PSM, sprint.trajectory(), slow)
    assert 0.99 < use.velocity_ratio <= 1.001


def test_what_the_arm_cannot_follow_is_refused():
    begin = np.array([0.3, 0.3, 0.02, 0, 0.0, 0])  # nearly on the remote centre
    end = np.array([-1.3, -0.8, 0.02, 0, 0, 0])
    with pytest.raises(TrocarError, match="straight"):
        line_of(begin, end).fastest_rate  # noqa: B018


STEP = 1 / PIECES
SHARES = np.linspace(0, 1, PIECES + 1)


def made_up(seed, bending=1.0):
    """A line of no arm, whose joints move and bend in any way; the last one only bends."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(2, 6)), rng.uniform(1, 4, 6)
    slope = waves[0][0] + 0.5 * np.sin(SHARES[:, None] * waves[1])
    slope[[3, 12]] *= 3.0  # there all must slow down
    slope[:, 5] = 0.0
    bend = bending * (waves[0][1] + np.cos(SHARES[:, None] * waves[1]))
    limits = MotionLimits(rng.uniform(0.3, 1, 6), rng.uniform(0.5, 2, 6))
    return StraightLine(np.zeros((PIECES + 1, 6)), slope, bend, limits)


def bounds_on(line, i, ahead):
    """Rows (k, 2) and their right sides: what x = (ds/dt)^2 at a knot and its change u to a neighbour may be."""
    here = np.stack([line.bend[i], line.slope[i]], axis=1)
    j = i + ahead
    there = np.stack([line.bend[j], line.slope[j] + 2 * ahead * STEP * line.bend[j]], axis=1)
    rows = np.concatenate([here, there])
    most = np.tile(line.limits.acceleration, 2)
    return np.concatenate([rows, -rows]), np.concatenate([most, most])


def most_of(cost, rows, most, x_bounds):
    found = linprog(-np.asarray(cost), A_ub=rows, b_ub=most, bounds=[x_bounds, (None, None)])
    assert found.status == 0
    return -found.fun


@pytest.mark.parametrize("seed", range(3))
def test_the_greatest_speeds_are_where_velocities_and_pairs_of_accelerations_leave_room(seed):
    """Against a linear programme at each knot, of the square of the speed and its change."""
    line = made_up(seed, bending=5.0)
    for i, square in enumerate(line.top_squares):
        rows = np.stack([line.bend[i], line.slope[i]], axis=1)
        cap = ((line.limits.velocity[:5] / np.abs(line.slope[i, :5])) ** 2).min()
        most = np.tile(line.limits.acceleration, 2)
        best = most_of([1, 0], np.concatenate([rows, -rows]), most, (0, cap))
        assert square == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_from_the_stoppable_speeds_the_end_can_be_reached_and_from_no_greater_ones(seed):
    line = made_up(seed, bending=5.0)
    squares, top = line.stoppable_squares, line.top_squares
    assert squares[-1] == top[-1]
    assert (squares < 0.99 * top).any()
    for i in range(PIECES - 1, -1, -1):
        rows, most = bounds_on(line, i, 1)
        next_one = np.array([1.0, 2 * STEP])
        rows, most = np.vstack([rows, next_one, -next_one]), np.concatenate([most, [squares[i + 1], 0.0]])
        assert squares[i] == pytest.approx(most_of([1, 0], rows, most, (0, top[i])), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_speeding_up_and_slowing_down_push_as_much_as_the_joints_may(seed):
    line = made_up(seed)
    up = line._sped_up(line.stoppable_squares)
    assert up[0] == 0.0
    for i in range(PIECES):
        rows, most = bounds_on(line, i, 1)
        push = most_of([0, 1], rows, most, (up[i], up[i]))
        assert up[i + 1] == pytest.approx(min(up[i] + 2 * STEP * push, line.stoppable_squares[i + 1]), rel=1e-6)
    startable = line.reversed().stoppable_squares[::-1]
    fastest = line.fastest_squares
    down = module._slowed_down(line, np.array([0.0, 0.3, 99.0]) * line.fastest_rate, startable)
    np.testing.assert_allclose(down[-1], np.array([0.0, 0.3, 1.0]) ** 2 * fastest[-1])
    for k in range(3):
        x = np.empty(PIECES + 1)
        x[-1] = down[-1, k]
        for i in range(PIECES, 0, -1):
            rows, most = bounds_on(line, i, -1)
            push = -most_of([0, -1], rows, most, (x[i], x[i]))
            x[i - 1] = min(x[i] - 2 * STEP * push, startable[i - 1])
        np.testing.assert_allclose(down[:, k], np.minimum(x, fastest), rtol=1e-6)


def even_line():
    """All joints go evenly, one radian or metre a line."""
    limits = MotionLimits(np.full(6, 1e3), np.full(6, 2.0))
    return StraightLine(np.repeat(SHARES[:, None], 6, axis=1), np.ones((PIECES + 1, 6)), np.zeros((17, 6)), limits)


def test_speeds_are_followed_within_one_percent_of_the_acceleration():
    line = even_line()
    assert line.follows(2 * 2.0 * 1.0099 * SHARES[:, None])
    assert not line.follows(2 * 2.0 * 1.0101 * SHARES[:, None])
    assert line.follows(2 * 2.0 * 1.0099 * SHARES[::-1, None])
    assert not line.follows(2 * 2.0 * 1.0101 * SHARES[::-1, None])
    stops = np.full((PIECES + 1, 1), 0.1)
    assert line.follows(stops)
    for place in (1, PIECES - 1):
        stopped = stops.copy()
        stopped[place] = 0.0
        assert not line.follows(stopped)
    assert line.follows(np.where(SHARES[:, None] * (1 - SHARES[:, None]) > 0, stops, 0.0))  # at rest at both ends
    assert line.fastest_rate == pytest.approx(2.0)  # sqrt(2 a s)


def test_what_a_sprint_takes_and_how_it_passes_its_knots():
    line, rate = made_up(0), np.array([0.4])
    line = StraightLine(np.cumsum(line.slope, axis=0) * STEP, line.slope, line.bend, line.limits)
    sprint = Sprint.to(line, rate * line.fastest_rate)
    assert sprint.rates == pytest.approx(rate * line.fastest_rate)
    x = sprint.squares[:, 0]
    push = np.diff(x) / (2 * STEP)
    piece_s = 2 * STEP / (np.sqrt(x[:-1]) + np.sqrt(x[1:]))
    assert sprint.seconds[0] == pytest.approx(piece_s.sum())
    for backwards in (False, True):
        motion = sprint.trajectory(backwards=backwards)
        along = slice(None, None, -1 if backwards else 1)
        np.testing.assert_allclose(np.diff(motion.times_s), piece_s[along])
        np.testing.assert_allclose(motion(motion.times_s), line.q[along], atol=1e-12)
        v = line.slope * np.sqrt(x)[:, None] * (-1 if backwards else 1)
        np.testing.assert_allclose(motion(motion.times_s, 1), v[along], atol=1e-9)
        after = line.slope[:-1] * push[:, None] + line.bend[:-1] * x[:-1, None]
        before = line.slope[1:] * push[:, None] + line.bend[1:] * x[1:, None]
        first, last = (before[::-1], after[::-1]) if backwards else (after, before)
        np.testing.assert_allclose(motion(motion.times_s[:-1], 2), first, atol=1e-7)
        np.testing.assert_allclose(motion(np.nextafter(motion.times_s[1:], 0), 2), last, atol=1e-7)


def test_quintics_join_positions_velocities_and_accelerations():
    rng = np.random.default_rng(0)
    times = np.cumsum([0.0, 0.7, 1.3, 0.4])
    q, v, left, right = (rng.normal(size=(n, 3)) for n in (4, 4, 3, 3))
    motion = quintics(times, q, v, left, right)
    assert len(motion.coefficients) == 6
    just_before = np.nextafter(times[1:], 0)
    for order, begin, end in ((0, q[:-1], q[1:]), (1, v[:-1], v[1:]), (2, left, right)):
        np.testing.assert_allclose(motion(times[:-1], order), begin, atol=1e-9)
        np.testing.assert_allclose(motion(just_before, order), end, atol=1e-9)


def test_joints_along_a_line_its_slopes_and_bends():
    line, back = line_of(FOUR[0], FOUR[2]), line_of(FOUR[2], FOUR[0])
    begin, end = fk(PSM, FOUR[0]), fk(PSM, FOUR[2])
    way_m = end.translation_m - begin.translation_m
    turn = (begin.rotation.inverse() @ end.rotation).log()
    tips = fk(PSM, line.q)
    np.testing.assert_allclose(tips.translation_m, begin.translation_m + SHARES[:, None] * way_m, atol=1e-8)
    turned = SO3.exp(SHARES[:, None] * turn)
    np.testing.assert_allclose((begin.rotation @ turned).matrix, tips.rotation.matrix, atol=1e-8)
    twist = np.concatenate([way_m, begin.rotation.apply(turn)])
    np.testing.assert_allclose(np.einsum("nij,nj->ni", jacobian(PSM, line.q), line.slope), [twist] * 17, atol=3e-4)
    np.testing.assert_allclose(line.bend[1:-1], np.gradient(line.slope, STEP, axis=0)[1:-1], atol=0.02)
    reverse = line.reversed()
    for name in ("q", "slope", "bend"):
        np.testing.assert_allclose(getattr(reverse, name), getattr(back, name), atol=1e-6)
