from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recounted import SHIFT, recounted
from trocar.arms import (
    ARMS,
    BRANCHES,
    PSM_CLASSIC,
    PSM_SI,
    RAVEN2_LEFT,
    Branch,
    fk,
    ik,
    ik_branches,
    ik_near,
    ik_unbounded,
    limit_violations,
)
from trocar.errors import OutOfReach, TrocarError
from trocar.geometry import SE3

arms = pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
seeds = st.integers(0, 2**32 - 1)
COUNT = 100_000


def sample(arm, seed, shape=()):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (*shape, 6))


@arms
def test_ik_inverts_fk_on_many_configurations(arm):
    q = sample(arm, 7, (COUNT,))
    T = fk(arm, q)
    found = ik(arm, T, q)
    np.testing.assert_allclose(fk(arm, found).matrix, T.matrix, rtol=0, atol=1e-12)
    # the same configuration, up to what the pose can tell of it near the remote centre
    np.testing.assert_allclose(found, q, rtol=0, atol=1e-8)
    assert np.all((found >= arm.lower) & (found <= arm.upper))


@arms
def test_without_bounds_the_tip_is_reached_though_a_joint_leaves_its_range(arm):
    q = sample(arm.widened(0.05, 0.0), 5, (5000,))
    T = fk(arm, q)
    found = ik_unbounded(arm, T)
    reached = np.isfinite(found).all(-1)
    np.testing.assert_allclose(fk(arm, found[reached]).matrix, T.matrix[reached], rtol=0, atol=1e-11)
    outside = ((q < arm.lower) | (q > arm.upper)).any(-1)
    own = reached & (np.abs((found - q)[:, [1, 2, 4, 5]]) < 1e-8).all(-1)
    assert (own & outside).sum() > 300


@arms
@given(seed=seeds)
def test_one_pose_is_solved_as_many_are(arm, seed):
    q = sample(arm, seed, (4,))
    T, near = fk(arm, q), sample(arm, seed + 1)
    one = [ik(arm, T[i], near) for i in range(4)]
    np.testing.assert_allclose(one, ik(arm, T, near), rtol=0, atol=1e-9)
    np.testing.assert_allclose(fk(arm, np.array(one)).matrix, T.matrix, rtol=0, atol=1e-12)


@arms
def test_every_real_branch_reaches_the_pose_and_one_lies_within_the_limits(arm):
    q = sample(arm, 3, (5000,))
    T = fk(arm, q)
    branches, real = ik_branches(arm, T)
    assert branches.shape == (5000, 8, 6)
    error = np.abs(fk(arm, branches).matrix - T.matrix[:, None])[real]
    assert error.max() < 1e-12
    inside = ((branches >= arm.lower - 1e-9) & (branches <= arm.upper + 1e-9)).all(-1) & real
    assert np.all(inside.sum(-1) <= 1)
    turned = arm.turns * np.rint((q[:, None] - branches) / (2 * np.pi))
    near = np.abs(branches + turned - q[:, None]).max(-1)
    assert np.all((near < 1e-8).sum(-1) == 1)  # the one it came from
    others = np.abs(branches[:, :, None] - branches[:, None]).max(-1) + 10 * np.eye(8)
    assert np.median(others) > 0.1  # and they differ


@pytest.mark.parametrize("first_twist_rad", [0.4, -0.4, 2.3, np.pi / 2 + 1e-3])
@pytest.mark.parametrize("wrist_sign", [1, -1])
def test_axes_may_meet_at_any_angle_and_joints_be_counted_from_anywhere(first_twist_rad, wrist_sign):
    """No registered arm has a first twist like these, nor offsets of its wrist."""
    arm = replace(RAVEN2_LEFT, name="odd", twists_rad=(first_twist_rad, 1.2, 2.0), wrist_sign=wrist_sign)
    arm = recounted(arm)
    q = sample(arm, 2, (50,))
    T = fk(arm, q)
    branches, real = ik_branches(arm, T)
    own = np.abs(branches - q[:, None] - arm.turns * np.rint((branches - q[:, None]) / (2 * np.pi))).max(-1) < 1e-7
    assert ((own & real).sum(-1) == 1).all()
    if wrist_sign == 1:  # the other wrist's depth is above the remote centre
        np.testing.assert_allclose(ik(arm, T, q), q, rtol=0, atol=1e-8)
        np.testing.assert_allclose([ik(arm, T[i], q[i]) for i in range(9)], q[:9], rtol=0, atol=1e-8)


def test_every_combination_of_signs_is_a_branch_in_the_order_of_the_solutions():
    assert set(BRANCHES) == {Branch(*signs) for signs in product((1, -1), repeat=3)} and len(BRANCHES) == 8
    arm = PSM_CLASSIC
    q, real = ik_branches(arm, fk(arm, np.random.default_rng(0).uniform(arm.lower, arm.upper, (20, 6))))
    assert real.all()
    turned = q + arm.offsets
    signs = np.sign([np.cos(turned[..., 5]), np.cos(turned[..., 4]), np.sin(turned[..., 1])])
    for number, branch in enumerate(BRANCHES):
        assert (signs[:, :, number] == np.array(branch)[:, None]).all(), branch


@arms
def test_branches_lie_within_half_a_turn_of_the_middle_of_their_ranges(arm):
    other = recounted(arm, 5 * SHIFT)
    branches, _ = ik_branches(other, fk(arm, sample(arm, 3, (50,))))
    off = np.abs(branches - other.middle)[..., [0, 1, 3, 4, 5]]
    assert np.nanmax(off) <= np.pi + 1e-9


def test_what_is_unreal_or_out_of_range_is_told_apart_where_bounds_do_not_count():
    """NaN where no joints have the pose; else those in the turns asked for."""
    arm = RAVEN2_LEFT
    above = SE3.from_parts(translation_m=[0, 0, 0.1])
    q = sample(arm, 6, (5,))
    T = fk(arm, q)
    turned = q + 2 * np.pi * np.array([1, 0, 0, -2, 0, 3])
    np.testing.assert_allclose(ik_unbounded(arm, T, turned), turned, atol=1e-8)
    np.testing.assert_allclose(ik_near(arm, T, turned), turned, atol=1e-8)
    np.testing.assert_allclose(ik_unbounded(arm, T[None]), q[None], atol=1e-8)
    assert np.isnan(ik_unbounded(arm, above)).any()
    with pytest.raises(OutOfReach, match="choose another pose"):
        ik_near(arm, SE3.unchecked(np.stack([T[0].matrix, above.matrix])), q[:2])


def test_rounding_beyond_a_limit_is_clipped_and_more_is_not():
    beyond = PSM_CLASSIC.middle.copy()
    for excess, reached in ((0.5e-9, True), (1.6e-9, False)):
        beyond[2] = PSM_CLASSIC.upper[2] + excess
        found = ik(PSM_CLASSIC, fk(PSM_CLASSIC, beyond), unreachable="nan")
        assert (found[2] == PSM_CLASSIC.upper[2]) == reached and np.isnan(found).all() != reached


def test_a_batch_larger_than_what_is_solved_at_a_time_comes_back_in_order():
    q = np.tile(sample(PSM_CLASSIC, 1, (500,)), (40, 1))
    q[:, 2] = np.linspace(0.05, 0.2, len(q))
    T = fk(PSM_CLASSIC, q)
    for found in (ik(PSM_CLASSIC, T, q), ik_unbounded(PSM_CLASSIC, T, q)):
        np.testing.assert_allclose(found, q, atol=1e-8)


def test_poses_and_references_of_several_axes_are_matched():
    q = sample(PSM_CLASSIC, 1, (3, 2))
    T, near = fk(PSM_CLASSIC, q), sample(PSM_CLASSIC, 2, (3, 1))
    found = ik(PSM_CLASSIC, T, near)
    assert found.shape == (3, 2, 6)
    np.testing.assert_array_equal(found, ik(PSM_CLASSIC, T, np.broadcast_to(near, (3, 2, 6))))
    several = ik(PSM_CLASSIC, T[0, 0], near)
    assert several.shape == (3, 1, 6)
    np.testing.assert_allclose(
        fk(PSM_CLASSIC, several).matrix, np.broadcast_to(T[0, 0].matrix, (3, 1, 4, 4)), atol=1e-12
    )


def test_psm_always_has_eight_branches_and_raven_does_not():
    assert ik_branches(PSM_CLASSIC, fk(PSM_CLASSIC, sample(PSM_CLASSIC, 1, (500,))))[1].all()
    raven = ARMS["raven2-left"]
    real = ik_branches(raven, fk(raven, sample(raven, 1, (500,))))[1].sum(-1)
    assert real.min() >= 1
    assert real.min() < 8  # the cone condition


@given(seed=seeds)
def test_the_roll_follows_the_reference_within_its_limits(seed):
    q = sample(PSM_CLASSIC, seed)
    T = fk(PSM_CLASSIC, q)
    rolls = [roll for roll in q[3] + 2 * np.pi * np.arange(-2, 3) if abs(roll) <= np.radians(260)]
    for roll in rolls:
        near = np.r_[q[:3], roll + 0.3, q[4:]]
        expected = min(rolls, key=lambda r: abs(r - near[3]))
        assert ik(PSM_CLASSIC, T, near)[3] == pytest.approx(expected, abs=1e-9)
        assert ik(PSM_CLASSIC, T[None], near)[0, 3] == pytest.approx(expected, abs=1e-9)
    assert abs(ik(PSM_CLASSIC, T)[3]) == pytest.approx(min(map(abs, rolls)), abs=1e-9)


@arms
def test_limits_themselves_are_reached(arm):
    """All 64 corners of the ranges, together and every third alone."""
    q = np.array(list(product(*arm.ranges)))
    T = fk(arm, q)
    for rows, found in ((q, ik(arm, T, q)), (q[::3], np.array([ik(arm, T[k], q[k]) for k in range(0, 64, 3)]))):
        np.testing.assert_allclose(fk(arm, found).matrix, fk(arm, rows).matrix, atol=1e-8)
        assert limit_violations(arm, found) == []


@arms
@pytest.mark.parametrize("shift_m", [1e-9, -1e-6])
def test_close_to_the_remote_centre_the_pose_still_comes_back(arm, shift_m):
    q = sample(arm, 5, (200,))
    q[:, 2] = shift_m - arm.offsets[2]  # wrist at the remote centre
    q[100:, 2] = np.clip(-arm.wrist_sign * -arm.wrist_length_m - arm.offsets[2] + shift_m, *arm.ranges[2])
    q[100:, 4] = 0.0  # where it can, jaw axis through the remote centre
    T = fk(arm, q)
    near = np.broadcast_to(arm.middle, q.shape)
    for found in (ik(arm, T, q), np.array([ik(arm, T[i], near[i]) for i in range(0, 200, 9)])):
        poses = T.matrix if len(found) == 200 else T.matrix[::9]
        np.testing.assert_allclose(fk(arm, found).matrix, poses, rtol=0, atol=1e-12)


@arms
def test_on_the_remote_centre_the_pose_comes_back_or_is_refused(arm):
    q = sample(arm, 5, (200,))
    q[:, 2] = -arm.offsets[2]
    q[:10, 3:] = 0.0  # here rounding leaves nothing of the depth
    for configuration in q:
        T = fk(arm, configuration)
        try:
            found = ik(arm, T)
        except OutOfReach:
            continue
        np.testing.assert_allclose(fk(arm, found).matrix, T.matrix, rtol=0, atol=1e-12)


def test_a_wrist_exactly_on_the_remote_centre_is_named():
    jaw_axis = SE3.from_parts(translation_m=[0.0, 0.0, -PSM_CLASSIC.tip_length_m])
    for T in (jaw_axis, jaw_axis[None]):
        with pytest.raises(OutOfReach, match="remote centre and turns freely"):
            ik(PSM_CLASSIC, T)


@pytest.mark.parametrize("name", ["psm-classic", "raven2-right"])
@settings(max_examples=40)
@given(seed=seeds)
def test_an_arm_with_wide_ranges_takes_the_nearest_branch(name, seed):
    arm = ARMS[name]
    joints = tuple(joint if joint.prismatic else replace(joint, lower=-3.1, upper=3.1) for joint in arm.joints)
    wide = replace(arm, joints=joints)
    assert not wide.branch_is_unique
    q = sample(wide, seed)
    if abs(q[2] + arm.offsets[2]) < 1e-3 or abs(np.sin(q[1] + arm.offsets[1])) < 1e-3:
        return
    T = fk(wide, q)
    for found in (ik(wide, T, q), ik(wide, T[None], q)[0]):
        np.testing.assert_allclose(found, q, rtol=0, atol=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_of_the_turns_of_a_joint_the_one_within_its_range_is_taken_though_the_reference_is_beyond_it(side):
    """The reference is nearest to a turn just outside; of the one before that, the joint is inside."""
    limits = (1.5, 1.5, None, 3.1, 1.5, 3.1)
    joints = zip(PSM_CLASSIC.joints, limits, strict=True)
    wide = replace(PSM_CLASSIC, joints=tuple(replace(j, lower=-end, upper=end) if end else j for j, end in joints))
    assert not wide.branch_is_unique
    q = np.array([0.2, 0.3, 0.15, -side * 3.0, 0.3, 0.2])
    near = q + [0.0, 0.0, 0.0, side * 6.2, 0.0, 0.0]  # 3.2 rad: the turn at 3.28 rad is nearer than the one at -3
    T = fk(wide, q)
    for found in (ik(wide, T, near), ik(wide, T[None], near)[0]):
        np.testing.assert_allclose(found, q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("roll", [2.5, 2.5 - 2 * np.pi, -2.5, 2 * np.pi - 2.5, 0.3])
def test_of_two_turns_within_the_range_the_one_nearest_to_the_reference_is_taken_also_of_many_branches(roll):
    joints = list(PSM_CLASSIC.joints)
    joints[1] = replace(joints[1], lower=-2.0, upper=2.0)
    wide = replace(PSM_CLASSIC, joints=tuple(joints))
    assert not wide.branch_is_unique
    q = np.array([0.2, 0.3, 0.15, roll, 0.3, 0.2])
    T = fk(wide, q)
    for aside in (0.5, -0.5):
        np.testing.assert_allclose(ik(wide, T, q + [0, 0, 0, aside, 0, 0]), q, rtol=0, atol=1e-9)


@arms
@settings(max_examples=30)
@given(seed=seeds)
def test_beyond_a_limit_the_joint_and_the_excess_are_named(arm, seed):
    rng = np.random.default_rng(seed)
    i = int(rng.integers(0, 3))
    q = arm.middle + 0.3 * (sample(arm, seed) - arm.middle)
    excess = 0.02 if i == 2 else 0.1
    q[i] = arm.upper[i] + excess
    if arm.name == "psm-si" and i == 0:
        excess = 0.1  # 170 + 6 deg, still short of -170
    with pytest.raises(OutOfReach, match=rf"'{arm.joints[i].name}' would be .*{excess:.4f} outside") as one:
        ik(arm, fk(arm, q))
    assert "\n" not in str(one.value)
    with pytest.raises(OutOfReach, match="pose 1 at"):
        ik(arm, fk(arm, np.array([arm.middle, q])))


def test_outside_the_cone_no_pitch_points_there():
    arm = ARMS["raven2-left"]  # its instrument stays within 53 to 157 deg of axis 1
    T = SE3.from_parts(translation_m=[0, 0, 0.1])
    with pytest.raises(OutOfReach):
        ik(arm, T)


@arms
def test_bad_poses_and_references_are_refused(arm):
    T = fk(arm, arm.middle)
    broken = T.matrix.copy()
    broken[0, 3] = np.nan
    for bad in (SE3.unchecked(broken), SE3.unchecked(broken[None])):
        with pytest.raises(TrocarError, match="NaN"):
            ik(arm, bad, unreachable="nan")  # what is no pose is not one that is out of reach
    for reference in (np.zeros(5), np.full(6, np.nan), "near"):
        with pytest.raises(TrocarError):
            ik(arm, T, reference)


def printed_ik(R, t, *, mended):
    """Equations of Hwang et al. 2022, IV-C, as printed, or with both slips mended."""
    L1, L2, L3, L4 = 0.4318, 0.4162, 0.0091, 0.0095
    x, y, z = -R.T @ t if mended else R.T @ t
    q6 = np.arctan2(x, z - L4)
    p = -L3 + np.hypot(x, z - L4)
    q3 = L1 - L2 + np.hypot(y, p)
    q5 = np.arctan2(-y, p)
    s5, c5, s6, c6 = np.sin(q5), np.cos(q5), np.sin(q6), np.cos(q6)
    R3b = np.array([[s5 * s6, -c6, c5 * s6], [c5, 0, -s5], [c6 * s5, s6, c5 * c6]])
    R3z = R3b.T @ R.T if mended else R3b @ R.T
    q2 = np.arcsin(R3z[2, 1])
    return np.array([np.arctan2(-R3z[2, 0], R3z[2, 2]), q2, q3, np.arctan2(R3z[1, 1], R3z[0, 1]), q5, q6])


def test_the_printed_formulas_fail_and_the_mended_ones_agree():
    q = sample(PSM_SI, 11, (200,))
    q[:, 2] = np.maximum(q[:, 2], 0.05)
    wrong = 0
    for T in map(lambda x: fk(PSM_SI, x), q):
        R, t = T.rotation.matrix, T.translation_m
        mended = printed_ik(R, t, mended=True)
        np.testing.assert_allclose(fk(PSM_SI, mended).matrix, T.matrix, atol=1e-14)
        np.testing.assert_allclose(ik(PSM_SI, T, mended), mended, atol=1e-12)
        printed = printed_ik(R, t, mended=False)
        wrong += np.abs(fk(PSM_SI, printed).matrix - T.matrix).max() > 0.01
    assert wrong == 200


@arms
def test_matrices_are_poses(arm):
    q = sample(arm, 4, (3,))
    T = fk(arm, q)
    np.testing.assert_array_equal(ik(arm, T.matrix, q), ik(arm, T, q))
    np.testing.assert_array_equal(ik(arm, T.matrix[0].tolist(), q[0]), ik(arm, T[0], q[0]))
    for wrong, words in ((np.eye(3), "shape"), (2 * np.eye(4), "length 1"), ("there", "numbers")):
        with pytest.raises(TrocarError, match=words):
            ik(arm, wrong)


@arms
def test_poses_out_of_reach_are_marked_and_cost_the_others_nothing(arm):
    q = sample(arm, 9, (5,))
    T = fk(arm, q).matrix.copy()
    T[[1, 3], 2, 3] += 2.0
    found = ik(arm, T, q, unreachable="nan")
    assert np.isnan(found).all(axis=1).tolist() == [False, True, False, True, False]
    np.testing.assert_array_equal(found[::2], ik(arm, T[::2], q[::2]))
    assert np.isnan(ik(arm, T[1], unreachable="nan")).all()
    with pytest.raises(OutOfReach, match="pose 1"):
        ik(arm, T, q)


def test_what_becomes_of_unreachable_poses_is_one_of_two_things():
    with pytest.raises(TrocarError, match="choose 'raise' or 'nan'"):
        ik(PSM_CLASSIC, fk(PSM_CLASSIC, PSM_CLASSIC.middle), unreachable="skip")
