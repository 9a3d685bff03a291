import cv2
import numpy as np

from trocar.geometry import SE3
from trocar.perception.depth import patch_around, pixel_rays, project
from trocar.perception.image import Intrinsics, RgbdImage

ZIVID = Intrinsics(1920, 1200, 2765.4, 2766.0, 962.9, 566.1, (-0.285, 0.407, -0.0001, 0.0001, -0.509))


def test_project_inverts_pixel_rays():
    camera = ZIVID.binned(4)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixel = project(camera, 0.6 * pixel_rays(camera))
    assert np.abs(pixel - np.stack([u, v], -1)).max() < 1e-9


def test_projects_as_opencv_does():
    points = np.random.default_rng(0).uniform([-0.2, -0.1, 0.4], [0.2, 0.1, 0.7], (100, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), ZIVID.matrix, np.array(ZIVID.distortion))
    assert np.abs(project(ZIVID, points) - expected[:, 0]).max() < 1e-6


def test_points_behind_the_camera_have_no_pixel():
    assert np.isnan(project(ZIVID, [0.0, 0.0, -1.0])).all()


def test_patch_is_none_outside_the_image():
    camera = ZIVID.binned(4)
    shape = (camera.height, camera.width)
    image = RgbdImage(np.zeros((*shape, 3), np.uint8), np.ones(shape, np.float32), camera)
    box = np.full(3, 0.01)
    assert patch_around(image, SE3.from_parts(translation_m=[2.0, 0, 0.6]), -box, box) is None
    patch = patch_around(image, SE3.from_parts(translation_m=[0, 0, 0.6]), -box, box)
    assert patch is not None and np.allclose(patch.points_m[..., 2], 1.0)
