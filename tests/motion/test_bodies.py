"""Arms on known motions, obstacles, and bounds on the acceleration of an instrument's parts."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from trocar.arms import ARMS, SOLIDS, capsules, wrist_depth_m
from trocar.arms.solids import solid_radii_m
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.motion import Capsule, MovingArm, open_box, rest_to_rest, wall
from trocar.motion.bodies import Bodies, _greatest_rates, _levers, greatest_accelerations, stacked
from trocar.trajectory import Trajectory
from waypoints import FOUR, LEFT, PAPER, PSM, RIGHT

ONE = MovingArm(PSM, rest_to_rest(FOUR[0], FOUR[1], PAPER), LEFT)
TWO = MovingArm(PSM, rest_to_rest(FOUR[2], FOUR[3], PAPER), RIGHT, 0.1)
THINGS = {"ball": Capsule([0, 0, 0], radius_m=0.01), "rod": Capsule([0, 0, 0], [1, 0, 0], 0.02)}


def test_an_arm_meets_other_arms_and_obstacles_and_these_do_not_meet_each_other():
    bodies = Bodies.of({"one": ONE}, {"two": TWO}, THINGS)
    parts = [*(f"one {solid}" for solid in SOLIDS), *(f"two {solid}" for solid in SOLIDS), "ball", "rod"]
    assert list(bodies.names) == parts
    assert sorted(map(tuple, bodies.pairs.tolist())) == sorted(product(range(4), range(4, 10)))
    np.testing.assert_array_equal(bodies.radii_m, [*solid_radii_m(PSM), *solid_radii_m(PSM), 0.01, 0.02])
    both = Bodies.of({"one": ONE, "two": TWO}, {}, THINGS)
    wanted = [*product(range(4), range(4, 8)), *product(range(8), (8, 9))]
    assert sorted(map(tuple, both.pairs.tolist())) == sorted(wanted)
    assert Bodies.of({"one": ONE}, {}, {}).pairs.shape == (0, 2)


def test_where_they_are_and_how_much_they_accelerate():
    bodies = Bodies.of({"one": ONE}, {"two": TWO}, THINGS)
    times = np.array([0.0, 0.05, 0.3])
    ends = bodies.ends_m(times)
    np.testing.assert_array_equal(ends[:, :4], ONE.ends_m(times))
    np.testing.assert_array_equal(ends[:, 4:8], TWO.ends_m(times))
    np.testing.assert_array_equal(ends[:, 8:], np.tile([[[0, 0, 0]] * 2, [[0, 0, 0], [1, 0, 0]]], (3, 1, 1, 1)))
    found = bodies.accelerations(times[:-1], times[1:])
    np.testing.assert_array_equal(found[:, :4], greatest_accelerations(ONE, times[:-1], times[1:]))
    np.testing.assert_array_equal(found[:, 4:8], greatest_accelerations(TWO, times[:-1], times[1:]))
    assert found.shape == (2, 10) and not found[:, 8:].any()


LATE = Trajectory.hermite([0.5, 1.0, 2.5], FOUR[:3], 0.01 * np.ones((3, 6)))


@pytest.mark.parametrize("start_s", [0.0, 0.3, -0.7])
def test_its_trajectory_begins_at_its_start_on_the_callers_clock(start_s):
    arm = MovingArm(PSM, LATE, LEFT, start_s, jaw_rad=0.4)
    np.testing.assert_allclose(arm.knots_s, start_s + np.array([0.0, 0.5, 2.0]))
    assert arm.end_s == pytest.approx(start_s + 2.0)
    times = start_s + np.array([-1.0, 0.0, 0.5, 1.1, 3.0])
    wanted = LATE([0.0, 0.5, 1.0, 1.6, 9.0])
    np.testing.assert_allclose(arm.joints(times), wanted)
    np.testing.assert_allclose(arm.joints(times[1:4], 1), LATE([0.5, 1.0, 1.6], 1))
    np.testing.assert_allclose(arm.ends_m(times), capsules(PSM, wanted, 0.4).moved(LEFT).ends_m)
    assert repr(arm) == f"<MovingArm psm-classic from {start_s:.3f} s to {start_s + 2:.3f} s>"


def test_one_that_rests_is_always_where_it_is():
    arm = MovingArm.resting(PSM, FOUR[1], LEFT, 0.2)
    assert arm.start_s == 0.0 and 0 < arm.end_s < 0.01 and arm.jaw_rad == 0.2
    np.testing.assert_array_equal(arm.joints([-5.0, 0.0, 5.0]), np.tile(FOUR[1], (3, 1)))
    there = capsules(PSM, FOUR[1], 0.2).moved(LEFT).ends_m
    np.testing.assert_allclose(arm.ends_m([-5.0, 5.0]), [there, there], rtol=0.0, atol=1e-15)
    assert not greatest_accelerations(arm, np.zeros(2), np.ones(2)).any()
    assert MovingArm(PSM, LATE).start_s == MovingArm(PSM, LATE).jaw_rad == 0.0
    assert MovingArm.resting(PSM, FOUR[1]).jaw_rad == 0.0


@pytest.mark.parametrize("given", [{"start_s": np.inf}, {"start_s": np.nan}, {"jaw_rad": np.nan}])
def test_times_and_jaws_are_finite(given):
    with pytest.raises(TrocarError, match="give finite numbers"):
        MovingArm(PSM, LATE, **given)


def test_it_has_as_many_joints_as_its_model():
    with pytest.raises(TrocarError, match="has 6 joints, its trajectory 5"):
        MovingArm(PSM, Trajectory([0.0, 1.0], np.zeros((1, 1, 5))))


BOX = open_box("box", SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3]), (0.11, 0.07), 0.03, 1.5e-3)


def test_nothing_2_mm_thick_passes_a_wall():
    """Along all lines that lead from inside to outside, level or slanting."""
    rng = np.random.default_rng(0)
    T = SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3])
    inside = rng.uniform([-0.05, -0.03, 1e-3], [0.05, 0.03, 0.029], (3000, 3))
    angle = rng.uniform(0, 2 * np.pi, 3000)
    outside = inside + 0.2 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    lines = T.apply(np.stack([inside, outside], axis=1))
    thin = Capsules(lines[:, None], np.array([1e-3]))
    assert capsule_distances_m(thin, stacked(BOX)).min(axis=(1, 2)).max() < 0.0


def test_what_is_inside_is_free():
    corners = np.array([[x, y, z] for x in (-0.0549, 0.0549) for y in (-0.0349, 0.0349) for z in (0.0, 0.03)])
    points = SE3.from_parts(SO3.axis("z", 0.4), [0.1, 0.2, 0.3]).apply(corners)
    dots = Capsules(np.repeat(points[:, None], 2, axis=1), np.zeros(8))
    assert capsule_distances_m(dots, stacked(BOX)).min() > 0.0


ROWS = [(1, 0.0, 1), (3, 0.0, 3), (3, 1e-6, 4), (3, -1e-6, 3), (2, 0.0, 2)]


@pytest.mark.parametrize(("rows", "more_m", "found"), ROWS)
def test_a_wall_has_no_more_rows_than_its_gaps_ask_for(rows, more_m, found):
    """Rows 4 mm thick, 1.5 mm apart at most."""
    height_m = 4e-3 + (rows - 1) * 5.5e-3 + more_m
    made = wall("fence", [0, 0, 0.1], [0.05, 0.01, 0.1], height_m=height_m, radius_m=2e-3)
    assert list(made) == [f"fence {k}" for k in range(found)]
    heights = np.array([row.start_m[2] for row in made.values()]) - 0.1
    np.testing.assert_allclose(heights, np.linspace(2e-3, height_m - 2e-3, found), atol=1e-12)
    for row in made.values():
        np.testing.assert_allclose(row.end_m - row.start_m, [0.05, 0.01, 0.0])
        assert row.radius_m == 2e-3


def test_a_box_is_closed_and_as_wide_inside_as_is_asked():
    box = open_box("box", SE3.from_parts(translation_m=[0.1, 0.2, 0.3]), (0.11, 0.07), 0.02, 2e-3)
    low = [box[f"box {k} 0"] for k in range(4)]
    for one, following in zip(low, [*low[1:], low[0]], strict=True):
        np.testing.assert_allclose(one.end_m, following.start_m)
    starts = np.array([one.start_m for one in low]) - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(np.abs(starts), np.tile([0.057, 0.037, 2e-3], (4, 1)))
    assert len(np.unique(starts.round(9), axis=0)) == 4
    assert len(box) == 16


@pytest.mark.parametrize(
    ("height_m", "radius_m", "made"),
    [(10.0, 0.5, True), (10.1, 0.5, False), (1.0, 0.0, False), (1.0, 0.5, True), (0.003, 0.002, False)],
)
def test_walls_are_thick_and_no_higher_than_ten_metres(height_m, radius_m, made):
    if made:
        assert wall("fence", [0, 0, 0], [1, 0, 0], height_m, radius_m)
    else:
        with pytest.raises(TrocarError, match="a wall cannot be"):
            wall("fence", [0, 0, 0], [1, 0, 0], height_m, radius_m)


def moving(coefficients, seconds=1.0, model=PSM):
    return MovingArm(model, Trajectory(np.array([0.0, seconds]), np.array(coefficients, dtype=float)[:, None]))


def bound(arm, begin=0.0, end=1e-9):
    return greatest_accelerations(arm, np.array([begin]), np.array([end]))[0]


@pytest.mark.parametrize("model", ARMS.values(), ids=lambda model: model.name)
def test_levers_are_the_greatest_distances_from_the_axes(model):
    depth_m, slid_m = np.array([0.1, 0.3]), np.array([0.01, 0.0])
    levers = _levers(model, depth_m, slid_m)
    wrist, finger, shaft = model.wrist_length_m, model.instrument.finger_length_m, model.instrument.shaft_length_m
    reach = [0.0, wrist, wrist + finger, wrist + finger]
    for row, (depth, slid) in enumerate(zip(depth_m, slid_m, strict=True)):
        shaft_m = max(depth + slid, abs(shaft - depth) + slid)  # its lower end or its upper one
        for joint in (0, 1):
            wanted = [shaft_m, *(depth + slid + r for r in reach[1:])]
            np.testing.assert_allclose(levers[row, :, joint], wanted)
        np.testing.assert_allclose(levers[row, :, 2], 1.0)
        for joint in (3, 4):
            np.testing.assert_allclose(levers[row, :, joint], reach)
        np.testing.assert_allclose(levers[row, :, 5], [0.0, 0.0, finger, finger])


def test_rates_within_an_interval_are_bounded_by_their_series_about_its_middle():
    """t^4 - t^2 and 2 t^3 about t = 0.5 +- 0.25: sums of all terms' sizes, exact where they have one sign."""
    arm = moving(np.stack([np.eye(6)[0], 2 * np.eye(6)[1], -np.eye(6)[0], np.eye(6)[3], PSM.middle]))
    speed, push = _greatest_rates(arm, np.array([0.5]), np.array([[0.25]]))
    h = 0.25
    first = abs(4 * 0.125 - 2 * 0.5) + abs(12 * 0.25 - 2) * h + 24 * 0.5 * h**2 / 2 + 24 * h**3 / 6
    np.testing.assert_allclose(speed[0, :4], [first, 6 * 0.25 + 12 * 0.5 * h + 12 * h**2 / 2, 0.0, 1.0])
    np.testing.assert_allclose(push[0, :4], [abs(12 * 0.25 - 2) + 24 * 0.5 * h + 24 * h**2 / 2, 6.0 + 12 * h, 0.0, 0.0])


def test_joints_that_turn_add_centripetal_and_coriolis_shares():
    """l v^2 alone; with a joint w before it l v (v + 2 w); a sliding one 2 w v more, and l a if it is pushed."""
    depth = abs(float(wrist_depth_m(PSM, PSM.middle)))
    tip = depth + PSM.wrist_length_m + PSM.instrument.finger_length_m
    reach = PSM.wrist_length_m + PSM.instrument.finger_length_m
    still = np.zeros(6)
    cases = [
        ([still, [2.0, 0, 0, 0, 0, 0]], tip * 4.0),
        ([still, [2.0, 3.0, 0, 0, 0, 0]], tip * (4.0 + 3.0 * (3.0 + 4.0))),
        ([still, [2.0, 0, 0.1, 0, 0, 0]], tip * 4.0 + 0.1 * 4.0),
        ([still, [0, 0, 0.1, 3.0, 0, 0]], reach * 9.0),
        ([still, [1.0, 0, 0, 2.0, 3.0, 0]], tip + reach * 2 * (2 + 2) + reach * 3 * (3 + 6)),
        ([[0.5, 0, 0.25, 0, 0, 0], still], tip * 1.0 + 0.5),
    ]
    for (push, rate), wanted in cases:
        arm = moving([push, rate, PSM.middle])
        assert bound(arm)[3] == pytest.approx(wanted, rel=1e-6)


def test_what_slides_in_an_interval_makes_the_levers_longer():
    arm = moving([[1.0, 0, 0.04, 0, 0, 0], PSM.middle])
    longer, shorter = bound(arm, 0.0, 1.0), bound(arm)
    np.testing.assert_allclose(longer[1:] - shorter[1:], 0.02 + 0.02, rtol=1e-3)  # the middle is .02 m from both
