"""The solids of an instrument, link by link and as capsules, against lengths by hand and the arm's frames."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from recounted import recounted
from trocar.arms import ARMS, SOLIDS, capsules, frames
from trocar.arms.solids import CARBON, HOUSING, MOVED, STEEL, joint_axes, parts_of, solid_radii_m

MM = 1e-3


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_every_solid_is_where_and_as_large_as_it_should_be(arm):
    shape, parts = arm.instrument, {part.name: part for part in parts_of(arm)}
    back = np.array([0.0, 0.0, arm.wrist_sign])  # of frame 4, towards the drive unit
    assert {name: part.link for name, part in parts.items()} == {
        **dict.fromkeys(("sleeve", "shaft", "drive"), 4),
        "wrist": 5,
        "knuckle": 6,
    }
    sleeve, shaft, drive = (parts[name] for name in ("sleeve", "shaft", "drive"))
    assert_allclose(sleeve.at_m / MM, np.outer([3, 18], back))
    assert_allclose(shaft.at_m / MM, np.outer([19, shape.shaft_length_m / MM], back))
    assert 0.9 * shape.shaft_radius_m < sleeve.size_m[0] < shape.shaft_radius_m == shaft.size_m[0]
    front_m = drive.at_m[0] - 0.5 * drive.size_m[2] * back
    assert_allclose(front_m, shape.shaft_length_m * back)  # it begins where the shaft ends
    assert min(drive.size_m) > 10 * shape.shaft_radius_m and max(drive.size_m) < 0.1

    knuckle, wrist = parts["knuckle"], parts["wrist"]
    assert knuckle.size_m == (shape.knuckle_radius_m,) and wrist.size_m == (shape.wrist_radius_m,)
    assert_allclose(knuckle.at_m, np.outer([0.45, -0.45], [0, 0, shape.finger_width_m]))
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper)
    poses = frames(arm, q)
    pitch, yaw = poses[5].translation_m, poses[6].translation_m
    assert_allclose(poses[5].apply(wrist.at_m), [pitch, pitch + 0.75 * (yaw - pitch)], atol=1e-12)
    assert {part.shape for part in (sleeve, shaft, knuckle)} == {"cylinder"}


def test_metal_is_grey_and_carbon_nearly_black():
    for rgb in (STEEL, HOUSING, CARBON):
        assert np.ptp(rgb) < 0.06 and max(rgb) < 1.0
    assert max(CARBON) < 0.2 and min(*STEEL, *HOUSING) > 0.5


ODD = recounted(replace(ARMS["raven2-right"], name="odd", twists_rad=(0.4, 1.2, 2.0), wrist_sign=-1))
ARM_CASES = pytest.mark.parametrize("arm", [*ARMS.values(), ODD], ids=lambda arm: arm.name)


@ARM_CASES
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), jaw_rad=st.floats(-0.5, 2.0))
def test_the_capsules_sit_on_the_frames_of_the_arm(arm, seed, jaw_rad):
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper, (3, 2, 6))
    shape, poses = arm.instrument, frames(arm, q)
    roll, pitch, yaw = (poses[..., k, :, :] for k in (4, 5, 6))
    up = arm.wrist_sign * np.array([0.0, 0.0, 1.0])
    ends = capsules(arm, q, jaw_rad).ends_m
    assert ends.shape == (3, 2, len(SOLIDS), 2, 3)
    expected = [
        (roll.apply(shape.shaft_radius_m * up), roll.apply(shape.shaft_length_m * up)),
        (pitch.translation_m, yaw.translation_m),
    ]
    for angle in (jaw_rad / 2, -jaw_rad / 2):
        along = np.array([-np.sin(angle), np.cos(angle), 0.0])
        expected.append((yaw.translation_m, yaw.apply(shape.finger_length_m * along)))
    for k, (start, end) in enumerate(expected):
        np.testing.assert_allclose(ends[..., k, 0, :], start, atol=1e-14)
        np.testing.assert_allclose(ends[..., k, 1, :], end, atol=1e-14)


@ARM_CASES
def test_one_opening_for_all_or_one_for_each(arm):
    q = np.tile(arm.middle, (3, 1))
    each = capsules(arm, q, [0.0, 0.3, 0.6]).ends_m
    for k, jaw_rad in enumerate((0.0, 0.3, 0.6)):
        np.testing.assert_array_equal(each[k], capsules(arm, q[k], jaw_rad).ends_m)


@ARM_CASES
def test_axes_of_the_joints_move_the_capsules_as_finite_differences_do(arm):
    rng = np.random.default_rng(0)
    q, step = rng.uniform(arm.lower, arm.upper, (20, 6)), 1e-6
    axes, origins = joint_axes(arm, q)
    ends = capsules(arm, q, 0.7).ends_m
    for joint in range(6):
        aside = step * np.eye(6)[joint]
        differences = (capsules(arm, q + aside, 0.7).ends_m - capsules(arm, q - aside, 0.7).ends_m) / (2 * step)
        axis, origin = axes[:, None, None, joint], origins[:, None, None, joint]
        moves = np.broadcast_to(axis, ends.shape) if joint == 2 else np.cross(axis, ends - origin)
        np.testing.assert_allclose(moves * MOVED[None, :, None, joint, None], differences, atol=1e-8)


@ARM_CASES
def test_each_capsule_is_as_thick_as_its_solid(arm):
    shape = arm.instrument
    expected = [shape.shaft_radius_m, shape.wrist_radius_m, shape.finger_radius_m, shape.finger_radius_m]
    np.testing.assert_array_equal(solid_radii_m(arm), expected)
    np.testing.assert_array_equal(capsules(arm, arm.middle).radii_m, expected)
    assert SOLIDS == ("shaft", "wrist", "left finger", "right finger")


@ARM_CASES
def test_axes_of_the_joints_are_those_of_their_frames_and_go_through_them(arm):
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (3, 2, 6))
    poses, (axes, origins) = frames(arm, q).matrix, joint_axes(arm, q)
    np.testing.assert_allclose(axes, poses[..., 1:7, :3, 2], atol=1e-12)
    aside = np.cross(origins - poses[..., 1:7, :3, 3], axes)
    np.testing.assert_allclose(aside[..., [0, 1, 3, 4, 5], :], 0.0, atol=1e-12)
