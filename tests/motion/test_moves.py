import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits, fk
from trocar.errors import TrocarError
from trocar.motion import duration_bound_s, limit_use, move_to, rest_to_rest, straight
from trocar.motion.double_integrator import phases_to_rest
from trocar.motion.limits import knot_jumps

LIMITS = MOTION_LIMITS["paper"]
PSM = ARMS["psm-classic"]
OVER_THE_BOARD = np.array([0.90, 0.08, 0.185, 0.27, 0.25, -0.88])


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(1e-6, 1))
def test_rest_to_rest_is_straight_within_limits_and_shortest(seed, share):
    rng = np.random.default_rng(seed)
    start, end = PSM.middle + rng.uniform(-0.45, 0.45, (2, 6)) * (PSM.upper - PSM.lower)
    end = start + share * (end - start)
    move = rest_to_rest(start, end, LIMITS)
    use = limit_use(PSM, move, LIMITS)
    assert use.kept
    assert max(use.velocity_ratio, use.acceleration_ratio) == pytest.approx(1, abs=1e-9)
    assert move.duration_s == pytest.approx(duration_bound_s([start, end], LIMITS), rel=1e-9)
    np.testing.assert_allclose(move(0.0), start, atol=1e-12)
    np.testing.assert_allclose(move(move.duration_s), end, atol=1e-12)
    np.testing.assert_allclose(move(np.nextafter(move.duration_s, 0), 1), 0, atol=1e-9)


def test_a_move_to_where_it_is_holds():
    for move in (rest_to_rest(PSM.middle, PSM.middle, LIMITS), straight(PSM, OVER_THE_BOARD, [0, 0, 0], LIMITS)):
        assert move.duration_s == pytest.approx(0.01)
        assert not move(np.linspace(0, 0.01, 5), 1).any()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), length_m=st.floats(1e-4, 0.03))
def test_straight_is_straight_for_the_tip_between_knots(seed, length_m):
    direction = np.random.default_rng(seed).normal(size=3)
    direction /= np.linalg.norm(direction)
    move = straight(PSM, OVER_THE_BOARD, length_m * direction, LIMITS)
    use = limit_use(PSM, move, LIMITS)
    assert use.kept
    assert max(use.velocity_ratio, use.acceleration_ratio) > 0.999
    T = fk(PSM, move(np.linspace(0, move.duration_s, 3001)))
    off = T.translation_m - T.translation_m[0]
    across = off - np.outer(off @ direction, direction)
    assert np.abs(across).max() < 1e-6
    np.testing.assert_allclose(off[-1], length_m * direction, atol=1e-9)
    assert np.abs((T.rotation @ T[0].rotation.inverse()).log()).max() < 1e-5


def test_straight_refuses_what_it_cannot_reach():
    with pytest.raises(TrocarError, match="out of its range"):
        straight(PSM, OVER_THE_BOARD, [0, 0, -0.15], LIMITS)
    with pytest.raises(TrocarError, match="displacement of a straight move must be finite"):
        straight(PSM, OVER_THE_BOARD, [0, 0, np.nan], LIMITS)
    with pytest.raises(TrocarError, match="end of a move must be finite"):
        rest_to_rest(PSM.middle, [0, 0, np.nan, 0, 0, 0], LIMITS)


def any_limits(rng):
    return MotionLimits(10 ** rng.uniform(-1, 1, 6), 10 ** rng.uniform(-1, 1, 6))


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(-6, 0), kind=st.sampled_from(["any", "edge", "stop", "some"]))
def test_a_move_from_under_way_is_the_shortest_and_keeps_its_limits(seed, size, kind):
    """Also from the limit itself, to where braking at once would end, and with joints that need not move."""
    rng = np.random.default_rng(seed)
    limits = any_limits(rng)
    start, goal = 10**size * rng.normal(size=(2, 6))
    velocity = rng.uniform(-1, 1, 6) * limits.velocity
    if kind == "edge":
        velocity = rng.choice([-1.0, 0.0, 0.5, 1.0], 6) * limits.velocity
    elif kind == "stop":
        goal = start + velocity * np.abs(velocity) / (2 * limits.acceleration)
    elif kind == "some":
        velocity[:3], goal[2:4] = 0.0, start[2:4]
    move = move_to(start, velocity, goal, limits)
    assert limit_use(PSM, move, limits).velocity_ratio <= 1 + 1e-9
    assert limit_use(PSM, move, limits).acceleration_ratio <= 1 + 1e-9
    assert move.duration_s == pytest.approx(duration_bound_s([start, goal], limits, velocity), rel=1e-9)
    np.testing.assert_allclose(move(0.0), start, atol=1e-12)
    np.testing.assert_allclose(move(0.0, 1), velocity, atol=1e-12)
    np.testing.assert_allclose(move(move.duration_s), goal, atol=1e-9)
    np.testing.assert_allclose(move(np.nextafter(move.duration_s, 0), 1), 0, atol=1e-6)
    assert max(knot_jumps(move, order).max(initial=0) for order in (0, 1)) < 1e-6


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 0.999))
def test_the_same_goal_again_on_the_way_there_changes_nothing(seed, share):
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(-1, 1, (2, 6))
    limits = any_limits(rng)
    first = rest_to_rest(start, end, limits)
    when = share * first.duration_s
    again = move_to(first(when), first(when, 1), end, limits)
    assert again.duration_s == pytest.approx(first.duration_s - when, abs=1e-6)  # a root of rounding
    times = np.linspace(0, again.duration_s, 50)
    np.testing.assert_allclose(again(times), first(when + times), atol=1e-7)


def test_from_rest_it_is_the_plain_move():
    start, end = PSM.middle, PSM.middle + [0.1, 0.2, 0.01, 1, 0, 0]
    move, plain = move_to(start, np.zeros(6), end, LIMITS), rest_to_rest(start, end, LIMITS)
    np.testing.assert_array_equal(move.coefficients, plain.coefficients)


@given(
    distance=st.floats(-2, 2),
    start=st.floats(-1, 1),
    late=st.floats(0, 3),
    velocity=st.floats(0.1, 3),
    acceleration=st.floats(0.1, 10),
)
def test_a_joint_that_waits_for_others_passes_its_goal_only_if_it_must(distance, start, late, velocity, acceleration):
    v0 = start * velocity
    stop = v0 * abs(v0) / (2 * acceleration)
    limits = MotionLimits(np.array([velocity]), np.array([acceleration]))
    seconds = duration_bound_s([[0.0], [distance]], limits, [v0]) + late
    q, v, lowest, highest, total = 0.0, v0, 0.0, 0.0, 0.0
    for lasts, a in phases_to_rest(distance, v0, seconds, velocity, acceleration):
        assert lasts >= 0 and abs(a) <= acceleration * (1 + 1e-12)
        turn = -v / a if a else 0.0
        extremes = [q + v * t + a * t * t / 2 for t in (lasts, min(max(turn, 0.0), lasts))]
        lowest, highest = min(lowest, *extremes), max(highest, *extremes)
        q, v, total = extremes[0], v + a * lasts, total + lasts
        assert abs(v) <= velocity * (1 + 1e-9)
    assert (q, v, total) == pytest.approx((distance, 0.0, seconds), abs=1e-7)
    assert lowest >= min(0.0, distance, stop) - 1e-7
    assert highest <= max(0.0, distance, stop) + 1e-7


def test_a_move_from_under_way_refuses_what_is_no_motion():
    with pytest.raises(TrocarError, match="velocity at the start of a move must be finite"):
        move_to(PSM.middle, [np.nan] * 6, PSM.middle, LIMITS)


@pytest.mark.parametrize(("length_m", "seconds"), [(0.05, 0.75), (0.016, 0.4), (0.001, 0.1)])
def test_straight_along_the_shaft_takes_the_time_of_the_insertions_trapezoid(length_m, seconds):
    """At .1 m/s and .4 m/s^2: d / v + v / a, or 2 sqrt(d / a)."""
    limits = MotionLimits(np.array([9, 9, 0.1, 9, 9, 9.0]), np.array([9, 9, 0.4, 9, 9, 9.0]))
    q = np.array([0, 0, 0.1, 0, 0, 0])
    along = fk(PSM, q + [0, 0, 1e-3, 0, 0, 0]).translation_m - fk(PSM, q).translation_m
    move = straight(PSM, q, along / np.linalg.norm(along) * length_m, limits)
    assert move.duration_s == pytest.approx(seconds, rel=1e-6)
    np.testing.assert_allclose(move(move.duration_s), q + [0, 0, length_m, 0, 0, 0], atol=1e-9)
    half = move(move.duration_s / 2)
    np.testing.assert_allclose(half, q + [0, 0, length_m / 2, 0, 0, 0], atol=1e-9)
    early = move(0.1 * seconds)[2] - 0.1
    assert early == pytest.approx(0.4 * (0.1 * seconds) ** 2 / 2, rel=1e-6)


def test_a_move_within_rounding_of_its_start_holds_and_one_further_moves():
    for step, moves in ((1e-15, False), (3e-15, True)):
        start = np.zeros(6)
        move = rest_to_rest(start, start + step * np.eye(6)[1], LIMITS)
        assert (np.abs(move.coefficients[0]).max() > 0 and len(move.coefficients) == 3) == moves


@pytest.mark.parametrize(("share", "refused"), [(1 + 0.5e-9, False), (1 + 2e-9, True)])
def test_a_start_may_be_as_fast_as_the_limit(share, refused):
    velocity = np.zeros(6)
    velocity[1] = -share * LIMITS.velocity[1]
    if refused:
        with pytest.raises(TrocarError, match="breaks the limits"):
            move_to(PSM.middle, velocity, PSM.middle, LIMITS)
    else:
        assert move_to(PSM.middle, velocity, PSM.middle, LIMITS).duration_s > 1.0
