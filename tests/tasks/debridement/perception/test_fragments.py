"""Fragments in two pictures: where they are, even behind a shaft, in jaws, in the receptacle, or side by side."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_scenes import RIG

from trocar.geometry import SE3, SO3
from trocar.perception.depth import project
from trocar.perception.image import StereoImage, StereoRig
from trocar.tasks.debridement.perception.regions import Region, group_regions, shifted_onto, solidity, split_convex
from trocar.tasks.debridement.perception.stereo_view import StereoView

VIEW = StereoView()
SMALL = StereoRig(RIG.left.binned(2), RIG.right.binned(2), RIG.T_left_right)
FAR_M = np.array([-0.03, -0.09, -0.158])
GREY = (120, 121, 125)


def look(stage, image=None):
    return VIEW.fragments(stage.show().image if image is None else image, stage.T_world_camera, stage.T_world_table)


def nearest(found, p):
    return min(found, key=lambda fragment: np.linalg.norm(fragment.p_world_m - p))


def test_all_are_found_where_they_lie(stage):
    shown = stage.show()
    found = look(stage, shown.image)
    assert len(found) == 6
    for p in shown.p_world_m.values():
        fragment = nearest(found, p)
        assert np.linalg.norm(fragment.p_world_m - p) < 1.5e-3
        assert 5e-3 < fragment.extent_m[1] <= fragment.extent_m[0] < 20e-3
        assert 2e-3 < fragment.height_m < 9e-3
        assert 0 <= fragment.yaw_rad < np.pi
        assert fragment.area_px > 100


@pytest.mark.parametrize("yaw_rad", [0.3, 1.3, 2.5])
def test_how_it_lies_is_told_by_its_long_side(stage, yaw_rad):
    """A flat red bar, painted at the height of a fragment's middle; jaws close across it."""
    T_world_bar = stage.T_world_table @ SE3.from_parts(SO3.axis("z", yaw_rad), [0.0, -0.07, 3.8e-3])
    corners = T_world_bar.apply(np.array([[9, 4, 0], [-9, 4, 0], [-9, -4, 0], [9, -4, 0]]) * 1e-3)
    pictures = []
    for eye in stage.eyes:
        pixels = project(eye.intrinsics, eye.T_world_camera.inverse().apply(corners))
        picture = np.full((eye.intrinsics.height, eye.intrinsics.width, 3), GREY, np.uint8)
        pictures.append(cv2.fillConvexPoly(picture, np.rint(pixels).astype(np.int32), (158, 13, 13)))
    (bar,) = look(stage, replace(stage.show().image, left=pictures[0], right=pictures[1]))
    assert bar.yaw_rad == pytest.approx(yaw_rad, abs=0.05)
    np.testing.assert_allclose(bar.extent_m, [0.018, 0.008], atol=1e-3)


def test_one_that_is_carried_is_seen_at_its_height(stage):
    stage.move("fragment0", [-0.07, -0.06, -0.162 + 0.045])
    fragment = nearest(look(stage), [-0.07, -0.06, -0.162 + 0.045])
    assert np.linalg.norm(fragment.p_world_m - [-0.07, -0.06, -0.162 + 0.045]) < 3e-3
    assert fragment.height_m == pytest.approx(0.045, abs=2e-3)


def test_one_in_the_receptacle_is_told_by_its_place(stage):
    middle = stage.scene.T_world_receptacle.apply([0.02, 0.0, 0.005])
    stage.move("fragment0", middle)
    found = look(stage)
    inside = [
        f for f in found if stage.scene.receptacle.holds(stage.scene.T_world_receptacle.inverse().apply(f.p_world_m))
    ]
    assert len(found) == 6 and len(inside) == 1
    assert np.linalg.norm(inside[0].p_world_m - middle) < 2e-3


@pytest.mark.parametrize("eyes", [("left",), ("left", "right")])
def test_one_behind_a_shaft_is_one(stage, eyes):
    shown = stage.show()
    p = shown.p_world_m["fragment1"]
    pictures = {"left": shown.image.left.copy(), "right": shown.image.right.copy()}
    T_camera_world, rig = stage.T_world_camera.inverse(), shown.image.rig
    for eye, aside in zip(eyes, (0, 12), strict=False):  # a shaft 25 mm above it
        at = T_camera_world.apply(p)
        lens = getattr(rig, eye)
        u, _ = project(lens, at if eye == "left" else rig.T_left_right.inverse().apply(at))
        pictures[eye][:, round(u) - 3 + aside : round(u) + 4 + aside] = GREY
    found = look(stage, replace(shown.image, **pictures))
    assert len(found) == 6
    fragment = nearest(found, p)
    assert np.linalg.norm(fragment.p_world_m - p) < 2e-3


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], ids=["side by side", "one behind the other"])
def test_two_that_touch_are_two(stage, direction):
    reach = {n: f.reach_m for n, f in zip(stage.world.free_bodies, stage.scene.fragments, strict=True)}
    lying = {name: stage.world.free_pose(name).translation_m[2] for name in reach}
    for name in list(reach)[2:]:
        stage.move(name, [0.3, 0.3, 0.0])
    apart = 0.85 * np.array(direction) * (reach["fragment0"] + reach["fragment1"])
    places = [np.array([-0.075, -0.07, lying["fragment0"]]), np.array([-0.075, -0.07, lying["fragment1"]]) + apart]
    for name, place in zip(("fragment0", "fragment1"), places, strict=True):
        stage.move(name, place)
    found = look(stage)
    assert len(found) == 2
    assert all(np.linalg.norm(nearest(found, p).p_world_m - p) < 3e-3 for p in places)


def test_nothing_is_seen_in_the_dark_or_by_one_eye(stage):
    image = stage.show().image
    dark = np.zeros_like(image.left)
    assert look(stage, StereoImage(dark, dark, image.rig)) == []
    assert look(stage, StereoImage(image.left, dark, image.rig)) == []
    assert look(stage, StereoImage(image.left, image.left, image.rig)) == [], "a right eye that shows the left picture"


# What both eyes see of one object, and outlines that are cut between their notches.


def test_what_one_eye_sees_is_put_where_the_other_one_has_it():
    whole = np.pad(np.full((4, 6), 255, np.uint8), 1)
    left = Region(whole[:, :4], (50, 10))
    right = Region(whole[:, 2:], (32, 10), pieces=2)
    both = left.united(right, 20.0)
    assert (both.corner_px, both.pieces) == ((50, 10), 2) and np.array_equal(both.mask, whole)
    assert np.array_equal(shifted_onto(left, right, 20.0)[:, 2:], whole[:, 2:4])
    full = Region(np.full((3, 4), 255, np.uint8), (7, 5))
    assert np.array_equal(shifted_onto(full, full, 0.0), full.mask), "to its very edges"
    assert not shifted_onto(full, full, 4.0).any() and not shifted_onto(full, full, -4.0).any()


HIGH_M, LOW_M = 0.3, 3.8e-3
"""Of the eyes above the table, looking straight down, and of the middles of fragments on it."""
FROM_ABOVE = SE3.from_parts(SO3.axis("x", np.pi), [0.0, 0.0, HIGH_M])


def pairs_of(lefts, rights):
    """Return the pairs that are made of small discs (u, v, radius) in the two pictures, by what they are apart."""
    masks = [np.zeros((SMALL.left.height, SMALL.left.width), np.uint8) for _ in range(2)]
    for mask, spots in zip(masks, (lefts, rights), strict=True):
        for u, v, radius in spots:
            cv2.circle(mask, (round(u), round(v)), radius, 255, cv2.FILLED)
    return [tuple(one.middle_px - other.middle_px) for one, other in group_regions(masks, SMALL, FROM_ABOVE, LOW_M)]


def disparity_px(height_m):
    return SMALL.left.fx * SMALL.T_left_right.translation_m[0] / (HIGH_M - height_m)


@pytest.mark.parametrize(
    ("off_px", "paired"), [(0, True), (-7, True), (-12, False), (7, True), (12, True), ("lifted", True), ("up", False)]
)
def test_spots_of_both_eyes_are_one_thing_from_a_little_below_the_table_up_to_where_one_is_carried(off_px, paired):
    px = disparity_px({"lifted": 0.14, "up": 0.17}.get(off_px, LOW_M)) + (0 if isinstance(off_px, str) else off_px)
    found = pairs_of([(400, 200, 5)], [(400 - round(px), 200, 5)])
    assert [round(u) for u, _ in found] == [round(px)] * paired


@pytest.mark.parametrize(
    ("rows", "radius", "paired"),
    [(0, 8, True), (5, 8, True), (-5, 8, True), (14, 8, False), (0, 6, True), (0, 4, False)],
)
def test_spots_are_one_thing_if_they_are_in_like_rows_and_of_like_size(rows, radius, paired):
    right = 400 - round(disparity_px(0.08))
    assert len(pairs_of([(400, 200, 8)], [(right, 200 + rows, radius)])) == paired
    nearer = pairs_of([(400, 200, 8)], [(right, 200 + rows, radius), (right - 20, 201, 8)])
    assert [round(v) for _, v in nearer] == [0 if rows == 0 and radius == 8 else -1], "of two, the more alike"


def discs(*centers):
    mask = np.zeros((120, 200), np.uint8)
    for center in centers:
        cv2.circle(mask, center, 25, 255, cv2.FILLED)
    return mask


def test_discs_that_overlap_are_cut_apart():
    for centers in (((50, 60), (92, 60)), ((40, 40), (75, 62), (112, 50))):
        parts = split_convex(discs(*centers), 3, 100)
        assert len(parts) == len(centers)
        for part in parts:
            v, u = np.nonzero(part)
            assert min(np.hypot(u.mean() - x, v.mean() - y) for x, y in centers) < 4


def test_a_dent_that_is_nearer_than_the_other_notch_does_not_attract_the_cut():
    mask = discs((50, 60), (80, 60))
    cv2.circle(mask, (97, 42), 2, 0, cv2.FILLED)
    parts = split_convex(mask, 3, 100)
    middles = sorted(float(np.nonzero(part)[1].mean()) for part in parts)
    assert len(parts) == 2 and middles == pytest.approx([46, 84], abs=3)


def test_what_is_convex_stays_whole():
    mask = discs((60, 60))
    (part,) = split_convex(mask, 3, 100)
    assert np.array_equal(part, mask)
    assert solidity(mask) > 0.97


def test_a_cut_leaves_no_crumbs():
    mask = discs((60, 60))
    cv2.circle(mask, (87, 60), 5, 255, cv2.FILLED)
    assert len(split_convex(mask, 1, 200)) == 1
    assert split_convex(np.zeros((20, 20), np.uint8), 3, 10) == []
