"""Painted spheres in a depth image: which one is which, and what is not a sphere."""

import numpy as np
import pytest

from trocar.perception.fiducials.detect import find_spheres
from trocar.perception.fiducials.fixture import COLORS, JAW, SHAFT, Fixture, Sphere
from trocar.perception.image import Intrinsics, RgbdImage

CAMERA = Intrinsics(480, 320, 900.0, 900.0, 239.5, 159.5)
WALL_M = 0.6
FIXTURE = Fixture(
    (
        Sphere(SHAFT, "red", 9e-3, (0.0, 0.0, 0.05)),
        Sphere(SHAFT, "red", 6e-3, (0.0, 0.0, 0.09)),
        Sphere(JAW, "green", 8e-3, (0.01, 0.02, 0.01)),
        Sphere(JAW, "blue", 8e-3, (-0.01, 0.02, -0.01)),
        Sphere(JAW, "yellow", 8e-3, (-0.01, 0.02, 0.01)),
    ),
    (0.0, 0.02, 0.0),
)
PLACES_M = np.array(
    [[-0.08, 0.02, 0.45], [-0.02, -0.03, 0.44], [0.03, 0.03, 0.46], [0.07, -0.02, 0.45], [0.0, 0.05, 0.45]]
)


def photographed(spheres, noise_m=0.0):
    """Return an image of spheres, (colour, radius, centre) each, before a grey wall."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    depth, color = np.full(u.shape, WALL_M), np.full((*u.shape, 3), 110, np.uint8)
    square = (rays**2).sum(axis=-1)
    for paint, radius_m, center_m in spheres:
        along = rays @ center_m
        inside = along**2 - square * (center_m @ center_m - radius_m**2)
        near = (along - np.sqrt(np.maximum(inside, 0.0))) / square
        hit = (inside > 0) & (near < depth)
        depth[hit], color[hit] = near[hit], np.round(255 * np.array(COLORS[paint]))
    depth = depth + noise_m * np.random.default_rng(0).normal(size=depth.shape)
    return RgbdImage(color, depth.astype(np.float32), CAMERA)


def as_worn(**changed):
    """Return the fixture's spheres at their places; ``n3=(colour, radius, centre)`` changes sphere 3."""
    made = [(s.color, s.radius_m, place) for s, place in zip(FIXTURE.spheres, PLACES_M, strict=True)]
    for name, sphere in changed.items():
        made[int(name[1:])] = sphere
    return made


@pytest.mark.parametrize(("noise_m", "off_m"), [(0.0, 2e-5), (2e-4, 1.5e-4)])
def test_every_sphere_is_found_and_two_of_one_colour_are_told_apart_by_size(noise_m, off_m):
    found = find_spheres(photographed(as_worn(), noise_m), FIXTURE)
    assert np.linalg.norm(found - PLACES_M, axis=1).max() < off_m


def test_places_do_not_tell_which_sphere_is_which():
    swapped = as_worn(n0=("red", 9e-3, PLACES_M[1]), n1=("red", 6e-3, PLACES_M[0]))
    found = find_spheres(photographed(swapped), FIXTURE)
    assert np.linalg.norm(found[:2] - PLACES_M[[1, 0]], axis=1).max() < 2e-5


def test_a_ball_of_the_right_colour_and_another_size_is_none_of_them():
    found = find_spheres(photographed(as_worn(n2=("green", 9e-3, PLACES_M[2]))), FIXTURE)
    assert np.isnan(found[2]).all() and np.isfinite(found[[0, 1, 3, 4]]).all()
    near = find_spheres(photographed(as_worn(n2=("green", 8.3e-3, PLACES_M[2]))), FIXTURE)
    assert np.isfinite(near[2]).all()  # within what the sensor may be off


def test_a_sphere_of_which_little_is_seen_is_not_found():
    before = ("blue", 12e-3, PLACES_M[4] * 0.9 + [0.0045, 0.0, 0.0])
    found = find_spheres(photographed([*as_worn(n3=("blue", 8e-3, PLACES_M[3])), before]), FIXTURE)
    assert np.isnan(found[4]).all()
    assert np.linalg.norm(found[3] - PLACES_M[3]) < 2e-5  # the larger blue one is none of the fixture's


def test_without_depth_there_is_nothing():
    image = photographed(as_worn())
    image.depth_m[:] = np.nan
    assert np.isnan(find_spheres(image, FIXTURE)).all()
