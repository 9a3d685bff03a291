"""Pose and opening of a gripper from its marks, visible or half hidden; and which pixels are read out for it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from stereo_scenes import RIG, STATION

from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import StereoImage, StereoRig
from trocar.tasks.debridement.perception.gripper import draw_marks
from trocar.tasks.debridement.perception.stereo_view import StereoView

VIEW = StereoView()
ARM = STATION.arms["left"].model
GREY = (120, 121, 125)
CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))
POSES = [
    (SO3.axis("z", 0.3), (-0.05, -0.06, -0.12), 0.8),
    (SO3.exp([0.3, 0.1, 0.0]) @ SO3.axis("z", -0.5), (-0.06, -0.05, -0.10), 1.2),
    (SO3.exp([-0.2, 0.2, 0.0]), (-0.03, -0.04, -0.14), 0.3),
]


def off(found, T_world_tip):
    E = T_world_tip.inverse() @ found.T_world_tip
    return float(np.linalg.norm(E.translation_m)), float(np.linalg.norm(E.rotation.log()))


def hide(image, ids, geoms):
    pictures = []
    for picture, seen in zip((image.left, image.right), ids, strict=True):
        hidden = picture.copy()
        hidden[np.isin(seen, geoms)] = GREY
        pictures.append(hidden)
    return replace(image, left=pictures[0], right=pictures[1])


def marks_of(stage, *names):
    return [stage.world.model.geom(f"left_mark_{name}").id for name in names]


@pytest.mark.parametrize("turn, place, jaw_rad", POSES)
def test_pose_and_opening_are_found(stage, turn, place, jaw_rad):
    T_world_tip = SE3.from_parts(turn, place)
    stage.put("left", T_world_tip, jaw_rad)
    found = VIEW.gripper(stage.show().image, stage.T_world_camera, ARM)
    assert found is not None
    away_m, turned_rad = off(found, T_world_tip)
    assert away_m < 0.5e-3 and turned_rad < np.radians(3.0)
    assert found.jaw_rad == pytest.approx(jaw_rad, abs=np.radians(2.0))


def test_a_hidden_mark_costs_little_and_two_of_them_the_pose(stage):
    turn, place, jaw_rad = POSES[0]
    stage.put("left", SE3.from_parts(turn, place), jaw_rad)
    shown = stage.show()
    for mark in ("left0", "left1", "right0", "right1"):
        found = VIEW.gripper(hide(shown.image, shown.ids, marks_of(stage, mark)), stage.T_world_camera, ARM)
        assert found is not None
        away_m, turned_rad = off(found, SE3.from_parts(turn, place))
        assert away_m < 1e-3 and turned_rad < np.radians(6.0)
    assert (
        VIEW.gripper(hide(shown.image, shown.ids, marks_of(stage, "left0", "left1")), stage.T_world_camera, ARM) is None
    )


def test_a_window_shows_the_same(stage):
    turn, place, jaw_rad = POSES[0]
    T_world_tip = SE3.from_parts(turn, place)
    stage.put("left", T_world_tip, jaw_rad)
    image = stage.show().image
    guess = SE3.from_parts(turn, np.array(place) + [0.008, -0.006, 0.007])
    window = VIEW.gripper_window(guess, stage.T_world_camera, image.rig, margin_m=0.015)
    assert window.left.corner_px[1] == window.right.corner_px[1] and window.left.size_px[1] == window.right.size_px[1]
    for eye, part in zip(stage.eyes, (window.left, window.right), strict=True):
        where = eye.T_world_camera.inverse().apply(guess.translation_m + 0.027 * CUBE)  # jaws and margin
        u = project(eye.intrinsics, where)[:, 0]
        ends = part.corner_px[0], part.corner_px[0] + part.size_px[0]
        np.testing.assert_allclose(ends, [u.min(), u.max()], atol=2.0, err_msg="columns of each eye")
    parts = []
    for picture, part in ((image.left, window.left), (image.right, window.right)):
        (u, v), (wide, high) = part.corner_px, part.size_px
        parts.append(np.ascontiguousarray(picture[v : v + high, u : u + wide]))
    found = VIEW.gripper(StereoImage(*parts, window.of(image.rig)), stage.T_world_camera, ARM)
    whole = VIEW.gripper(image, stage.T_world_camera, ARM)
    assert np.abs(found.T_world_tip.matrix - whole.T_world_tip.matrix).max() < 1e-6


def test_a_window_has_the_rows_in_which_both_eyes_may_show_the_gripper(stage):
    rig = stage.show().image.rig
    guess = stage.T_world_camera @ SE3.from_parts(translation_m=[0.0, 0.0, 0.3])
    level = VIEW.gripper_window(guess, stage.T_world_camera, rig)
    for lower_px in (10, -10):
        askew = StereoRig(rig.left, replace(rig.right, cy=rig.right.cy + lower_px), rig.T_left_right)
        window = VIEW.gripper_window(guess, stage.T_world_camera, askew)
        assert window.left.corner_px[1] == window.right.corner_px[1] == level.left.corner_px[1] + max(lower_px, 0)
        assert window.left.size_px[1] == window.right.size_px[1] == level.left.size_px[1] - abs(lower_px)


def test_there_is_no_window_out_of_sight(stage):
    rig = StereoRig(RIG.left, RIG.right, RIG.T_left_right)
    assert VIEW.gripper_window(SE3.from_parts(translation_m=[0.3, 0.0, -0.1]), stage.T_world_camera, rig) is None
    assert VIEW.gripper_window(SE3.from_parts(translation_m=[0.0, 0.5, 0.3]), stage.T_world_camera, rig) is None


def test_nothing_is_made_up(stage):
    image = stage.show().image
    dark = np.zeros_like(image.left)
    assert VIEW.gripper(StereoImage(dark, dark, image.rig), stage.T_world_camera, ARM) is None
    assert VIEW.gripper(StereoImage(image.left, image.left, image.rig), stage.T_world_camera, ARM) is None
    bare = replace(ARM, name="bare", instrument=replace(ARM.instrument, marks=None))
    assert VIEW.gripper(image, stage.T_world_camera, bare) is None


@pytest.mark.parametrize("turn, place, jaw_rad", POSES)
def test_drawings_look_as_the_marks_do(stage, turn, place, jaw_rad):
    stage.put("left", SE3.from_parts(turn, place), jaw_rad)
    shown = stage.show()
    eye = stage.eyes[0]
    T_eye_tip = stage.T_world_camera.inverse() @ SE3.from_parts(turn, place)
    drawing = draw_marks(ARM.instrument, ARM.tip_length_m, eye.intrinsics, T_eye_tip, jaw_rad, 4.0)
    for number, geom in enumerate(marks_of(stage, "left0", "left1", "right0", "right1")):
        v, u = np.nonzero(shown.ids[0] == geom)
        drawn = drawing[number]
        assert np.linalg.norm(drawn.mean(0) - [u.mean(), v.mean()]) < 0.3
        assert len(drawn) / 4.0**2 == pytest.approx(len(u), rel=0.15)


# Whether jaws hold something red, in both eyes.

JAW_RAD = 0.5
T_WORLD_TIP = SE3.from_parts(SO3.axis("z", 0.4), (-0.06, -0.06, -0.11))


def holding(stage, image=None, jaw_rad=JAW_RAD):
    return VIEW.holding(stage.show().image if image is None else image, stage.T_world_camera, ARM, T_WORLD_TIP, jaw_rad)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.002, 0, -0.004), (0, 0.003, -0.006)])
def test_a_fragment_between_the_fingers_is_held(stage, shift):
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    stage.move("fragment0", T_WORLD_TIP.translation_m + shift)
    assert holding(stage)


def alone(stage, p_world_m):
    """Take all fragments away, and put one of them back."""
    for number in range(6):
        stage.move(f"fragment{number}", [0.3, 0.3, 0.0])
    stage.move("fragment0", p_world_m)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_fragment_that_hangs_from_the_end_of_a_finger_is_seen(stage, side):
    wide_rad = 2.0
    stage.put("left", T_WORLD_TIP, wide_rad)
    alone(stage, T_WORLD_TIP.apply(np.array([0.0215 * side, -0.002, -0.0045])))
    assert holding(stage, jaw_rad=wide_rad)


@pytest.mark.parametrize("aside", [(0, 0), (0.01, 0.0), (0.0, -0.01), (0.0, -0.04), (0.3, 0.3)])
def test_what_lies_on_the_table_below_is_not_held(stage, aside):
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    alone(stage, [*(T_WORLD_TIP.translation_m[:2] + aside), -0.158])
    assert not holding(stage)


def test_dark_eyes_see_nothing_held(stage):
    image = stage.show().image
    dark = np.zeros_like(image.left)
    assert not holding(stage, StereoImage(dark, dark, image.rig))
    stage.put("left", T_WORLD_TIP, JAW_RAD)
    stage.move("fragment0", T_WORLD_TIP.translation_m)
    image = stage.show().image
    assert not holding(stage, StereoImage(image.left, dark, image.rig))
