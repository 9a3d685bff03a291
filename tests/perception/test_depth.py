import cv2
import numpy as np
import pytest

from trocar.geometry import SE3
from trocar.perception.depth import Patch, patch_around, pixel_rays, project, rays_through, undistort
from trocar.perception.image import Intrinsics, RgbdImage

ZIVID = Intrinsics(1920, 1200, 2765.4, 2766.0, 962.9, 566.1, (-0.285, 0.407, -0.0001, 0.0001, -0.509))
SMALL = Intrinsics(100, 80, 64.0, 32.0, 50.25, 40.5)
BENT = Intrinsics(40, 30, 40.0, 44.0, 19.0, 15.5, (-0.2, 0.3, 0.02, -0.03, -0.1))


def image_of(camera, depth_m=0.5):
    """Return an image whose colours tell rows and columns."""
    v, u = np.mgrid[: camera.height, : camera.width]
    color = np.stack([u, v, np.zeros_like(u)], -1).astype(np.uint8)
    return RgbdImage(color, np.full(u.shape, depth_m, np.float32), camera)


# The lens.


def test_project_inverts_pixel_rays():
    camera = ZIVID.binned(4)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixel = project(camera, 0.6 * pixel_rays(camera))
    assert np.abs(pixel - np.stack([u, v], -1)).max() < 1e-9


@pytest.mark.parametrize("camera", [ZIVID, BENT])
def test_projects_as_opencv_does(camera):
    points = np.random.default_rng(0).uniform([-0.2, -0.1, 0.4], [0.2, 0.1, 0.7], (100, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    assert np.abs(project(camera, points) - expected[:, 0]).max() < 1e-6


def test_a_strongly_bent_lens_is_straightened_out():
    straight = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 2))
    pixels = project(BENT, np.column_stack([straight, np.ones(50)]))
    np.testing.assert_allclose(rays_through(BENT, pixels)[:, :2], straight, atol=1e-9)
    assert undistort(BENT, np.zeros((0, 2))).shape == (0, 2)


def test_points_behind_the_camera_and_beside_it_have_no_pixel():
    assert np.isnan(project(ZIVID, [[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]])).all()
    assert np.isfinite(project(ZIVID, [0.0, 0.0, 1e-3])).all()


def test_rays_have_depth_one_and_belong_to_all_who_ask():
    rays = pixel_rays(SMALL)
    assert rays.shape == (80, 100, 3) and (rays[..., 2] == 1.0).all()
    np.testing.assert_allclose(rays[3, 7], [(7 - 50.25) / 64, (3 - 40.5) / 32, 1.0])
    with pytest.raises(ValueError, match="read-only"):
        rays[0, 0, 0] = 1.0


# A rectangle of an image.


def test_a_patch_has_points_where_its_depth_is():
    rays = np.array([[[0.5, 0.25, 1.0], [0.0, -0.5, 1.0]]])
    patch = Patch(rays, np.array([[0.4, np.nan]]), np.zeros((1, 2, 3), np.uint8))
    np.testing.assert_allclose(patch.points_m[0, 0], [0.2, 0.1, 0.4])
    assert np.isnan(patch.points_m[0, 1]).all()


def test_a_thinned_patch_has_one_of_so_many_rows_and_columns():
    rays, depth, color = pixel_rays(SMALL), np.arange(8000.0).reshape(80, 100), image_of(SMALL).color
    thinned = Patch(rays, depth, color).thinned(7)
    np.testing.assert_array_equal(thinned.color[..., 0], np.tile(np.arange(0, 100, 7), (12, 1)))
    np.testing.assert_array_equal(thinned.color[..., 1], np.tile(np.arange(0, 80, 7), (15, 1)).T)
    assert thinned.depth_m[1, 2] == depth[7, 14] and thinned.rays[1, 2].tolist() == rays[7, 14].tolist()


def covered(lower, upper, T=None):
    """Return (u0, u1, v0, v1), the columns and rows of the patch about a box, last ones included, or None."""
    image = image_of(SMALL)
    patch = patch_around(image, T or SE3.identity(), lower, upper)
    if patch is None:
        return None
    u, v = patch.color[..., 0], patch.color[..., 1]
    np.testing.assert_array_equal(patch.rays, pixel_rays(SMALL)[v, u])
    assert (patch.depth_m == 0.5).all() and patch.depth_m.shape == u.shape and patch.depth_m.dtype == np.float64
    return u.min(), u.max(), v.min(), v.max()


def test_a_patch_covers_the_corners_of_its_box():
    """From the pixel that the first corner lies in to the one after the last corner's."""
    assert covered([-0.25, -0.25, 1.0], [0.25, 0.25, 1.0]) == (34, 67, 32, 49)
    # The near face reaches farther out, the far one farther in: 50.25 + 64 * (.25 / 2 to .5), 40.5 - 32 * (.5 to .125).
    assert covered([0.25, -0.5, 1.0], [0.5, -0.25, 2.0]) == (58, 83, 24, 37)
    assert covered([-0.5, 0.25, 1.0], [-0.25, 0.5, 2.0]) == (18, 43, 44, 57)
    moved = SE3.from_parts(translation_m=[0.25, -0.5, 1.0])
    assert covered([0.0, 0.0, 0.0], [0.25, 0.25, 1.0], moved) == (58, 83, 24, 37)


def test_a_patch_ends_where_the_image_does():
    assert covered([-9.0, -9.0, 1.0], [9.0, 9.0, 1.0]) == (0, 99, 0, 79)
    assert covered([0.70, 0.0, 1.0], [0.71, 0.25, 1.0]) == (95, 96, 40, 49)
    assert covered([0.75, 0.0, 1.0], [2.0, 0.25, 1.0]) == (98, 99, 40, 49)
    assert covered([-2.0, 0.0, 1.0], [-0.785, 0.25, 1.0]) == (0, 1, 40, 49)
    assert covered([0.0, 1.175, 1.0], [0.25, 2.0, 1.0]) == (50, 67, 78, 79)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        ([0.77, 0.0, 1.0], [2.0, 0.25, 1.0]),  # one column is left
        ([-2.0, 0.0, 1.0], [-0.81, 0.25, 1.0]),
        ([0.0, 1.21, 1.0], [0.25, 2.0, 1.0]),  # one row
        ([0.0, -2.0, 1.0], [0.25, -1.31, 1.0]),
        ([-0.1, -0.1, -0.5], [0.1, 0.1, 0.5]),  # it reaches behind the camera
    ],
)
def test_a_box_that_the_camera_does_not_see_has_no_patch(lower, upper):
    assert covered(lower, upper) is None
