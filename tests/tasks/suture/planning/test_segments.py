"""The path that the arm drives is the primitive, with a way in and a way out."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS, fk, wrist_depth_m
from trocar.errors import TrocarError
from trocar.tasks.suture.planning import DIRECTIONS, PRESETS, suture_joints
from trocar.tasks.suture.planning.primitive import SPACING_RAD, Suture, driven_steps, grasp_pose, path_samples, steps
from trocar.tasks.suture.planning.segments import BEYOND_RAD, ROOM_RAD, ranges, retreat, suture_segments

SETUP = PRESETS["default"].setup
ANGLES = st.floats(0.0, 2 * math.pi)


@given(ANGLES, st.sampled_from(DIRECTIONS))
@settings(max_examples=40, deadline=None)
def test_the_pieces_join_and_pass_the_primitives_stations(theta, direction):
    """All are met but where the jaws take the needle again: there the arm goes further back, to let go later."""
    pieces = suture_segments(Suture(SETUP, theta, direction))
    assert [p.name for p in pieces] == ["lower", "approach", *(step.name for step in steps(SETUP)), "withdraw", "rise"]
    inner = [p for p in pieces if len(p.q)]
    for before, after in pairwise(inner):
        np.testing.assert_allclose(before.q[len(before.q) - 1 - before.beyond], after.q[0], atol=1e-6)
    planned = suture_joints(SETUP, [theta])
    row = DIRECTIONS.index(direction)
    primitive = np.concatenate([p.q for p in pieces[2:-2]])
    nearest = [np.abs(primitive - q).max(axis=1).min() for q in planned.q[row, 0][planned.station]]
    again = SETUP.insertion.rotation_rad - SETUP.insertion.regrasp_rad
    met = np.abs(path_samples(SETUP).jaws_rad[planned.station] - again) > 1e-9
    np.testing.assert_array_less(np.where(met, nearest, 0.0), 1e-6)
    assert sum(~met) == 1 and max(nearest) < 0.04


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_open_jaws_go_back_further_than_where_they_close_and_forward_again(direction):
    pieces = suture_segments(Suture(SETUP, 1.0, direction))
    for piece, then in pairwise(pieces):
        if not piece.regrasps:
            assert piece.beyond == 0
            continue
        assert piece.beyond == round(BEYOND_RAD / SPACING_RAD)
        back = piece.back
        np.testing.assert_array_equal(back.q[0], piece.q[-1])
        np.testing.assert_allclose(back.q[-1], then.q[0], atol=1e-6)
        assert back.length_m == pytest.approx(SETUP.needle.radius_m * BEYOND_RAD, rel=0.1)
        end, beyond, pushed = (fk(SETUP.arm, q).translation_m for q in (then.q[0], piece.q[-1], then.q[5]))
        assert np.dot(beyond - end, pushed - end) < 0.0  # away from where they push


def test_jaws_do_not_go_back_beyond_where_the_primitive_takes_them():
    insertion = replace(SETUP.insertion, regrasp_rad=SETUP.insertion.rotation_rad, pushes=1)
    setup = replace(SETUP, insertion=insertion)
    for piece, step in zip(suture_segments(Suture(setup, 1.0, 1))[2:-2], driven_steps(setup), strict=True):
        if piece.regrasps:
            assert piece.beyond * SPACING_RAD <= max(step.jaws_rad[1], 0.0) + 1e-9 < BEYOND_RAD


def test_from_anywhere_the_jaws_come_off_along_themselves_and_up():
    suture = Suture(SETUP, 1.0, 1)
    q = suture_segments(suture)[3].q[20]
    withdraw, rise = retreat(SETUP, q)
    assert (withdraw.name, rise.name) == ("withdraw", "rise")
    np.testing.assert_allclose(withdraw.q[0], q, atol=1e-6)
    np.testing.assert_allclose(rise.q[0], withdraw.q[-1], atol=1e-6)
    here, off, up = (fk(SETUP.arm, at) for at in (q, withdraw.q[-1], rise.q[-1]))
    # at q = 0 the tool points along -z of a frame that is the base's: away from what it holds is +z
    np.testing.assert_allclose(here.inverse().apply(off.translation_m), [0.0, 0.0, 0.010], atol=1e-6)
    normal = SETUP.T_base_circle.rotation.matrix[:, 2]
    along = (up.translation_m - off.translation_m) / np.linalg.norm(up.translation_m - off.translation_m)
    np.testing.assert_allclose(along, normal, atol=1e-6)


@given(ANGLES, st.sampled_from(DIRECTIONS))
@settings(max_examples=40, deadline=None)
def test_driven_joints_carry_the_needle_along_its_path(theta, direction):
    """Forward kinematics of the joints, with the needle in the jaws, must give the needle's path back."""
    suture = Suture(SETUP, theta, direction)
    T_tip_needle = grasp_pose(SETUP).inverse()
    T_circle_base = SETUP.T_base_circle.inverse()
    path = suture.needle_path_m
    for piece in suture_segments(suture)[2:4]:  # penetrate, rotate: before any regrasp
        T_circle_needle = T_circle_base @ fk(SETUP.arm, piece.q) @ T_tip_needle
        tips = T_circle_needle.apply([0.0, -SETUP.needle.radius_m, 0.0])
        nearest = np.linalg.norm(tips[:, None] - path, axis=-1).min(axis=1)
        assert nearest.max() < 0.2e-3  # the path's points lie .25 mm and 1 deg apart
        assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.4e-3


@given(ANGLES, st.sampled_from(DIRECTIONS))
def test_it_goes_in_and_comes_out_half_a_bite_before_and_after_theta_in_its_direction(theta, direction):
    suture = Suture(SETUP, theta, direction)
    out = suture.exit_m
    assert out is not None and abs(out[2]) < 1e-9 and abs(suture.entry_m[2]) < 1e-12
    radius = SETUP.circle.radius_m
    middle = [radius * math.cos(theta), radius * math.sin(theta), 0.0]
    np.testing.assert_allclose((suture.entry_m + out) / 2, middle, atol=1e-12)
    assert np.linalg.norm(out - suture.entry_m) == pytest.approx(SETUP.bite_m)
    assert np.dot(out - suture.entry_m, middle) == pytest.approx(0.0, abs=1e-12), "along the tangent"
    clockwise = np.cross(suture.entry_m, out - suture.entry_m)[2] < 0
    assert clockwise == (direction == 1)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_ways_in_and_out_keep_to_the_ranges_and_the_primitive_says_where_it_does_not(direction):
    feasible = suture_joints(SETUP, np.radians(np.arange(0.0, 360.0, 6.0))).feasible
    row = DIRECTIONS.index(direction)
    for degrees, can in zip(np.arange(0.0, 360.0, 6.0), feasible[row], strict=True):
        pieces = suture_segments(Suture(SETUP, math.radians(degrees), direction))
        primitive, ways = pieces[2:-2], (*pieces[:2], *pieces[-2:])
        assert all(piece.first_outside(SETUP.arm) is None for piece in ways)
        assert all(piece.first_outside(SETUP.arm, ROOM_RAD) is None for piece in ways[::3])
        inside = all(piece.first_outside(SETUP.arm) is None for piece in primitive)
        assert inside == can
    assert feasible[row].any() and not feasible[row].all()


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
@given(st.floats(-0.05, 0.3))
def test_the_insertions_range_ends_where_the_wrist_is_at_its_safe_depth(arm, insertion):
    lower, upper = ranges(arm)
    q = np.array([0.0, 0.0, insertion, 0.0, 0.0, 0.0])
    inside = arm.lower[2] <= insertion <= arm.upper[2] and wrist_depth_m(arm, q) >= arm.safe_depth_m
    assert (lower[2] <= insertion <= upper[2]) == inside
    others = [0, 1, 3, 4, 5]
    assert (lower[others] == arm.lower[others]).all() and (upper[others] == arm.upper[others]).all()


def test_nonsense_is_refused_in_a_sentence():
    with pytest.raises(TrocarError, match="direction of a suture is 2"):
        Suture(SETUP, 0.0, 2)
    with pytest.raises(TrocarError, match="finite angle"):
        Suture(SETUP, math.nan, 1)
