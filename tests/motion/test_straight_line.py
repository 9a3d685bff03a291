import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, MotionLimits, fk, ik
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.motion import limit_use, straight
from trocar.motion.straight_line import Sprint, StraightLine
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
    motion = sprint.trajectory(0, backwards=backwards)
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


def test_faster_ends_take_less_time_and_none_is_beyond_the_fastest():
    line = line_of(FOUR[0], FOUR[1])
    sprint = Sprint.to(line, np.linspace(0, 2 * line.fastest_rate, 30))
    assert sprint.rates.max() == pytest.approx(line.fastest_rate)
    assert np.all(np.diff(sprint.seconds) <= 1e-12)


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
    use = limit_use(PSM, sprint.trajectory(0), slow)
    assert 0.99 < use.velocity_ratio <= 1.001


def test_what_the_arm_cannot_follow_is_refused():
    begin = np.array([0.3, 0.3, 0.02, 0, 0.0, 0])  # nearly on the remote centre
    end = np.array([-1.3, -0.8, 0.02, 0, 0, 0])
    with pytest.raises(TrocarError, match="straight"):
        line_of(begin, end).fastest_rate  # noqa: B018
