"""Painted spheres in a depth image: which one is which, and what is not a sphere."""

import colorsys
from dataclasses import replace

import numpy as np
import pytest

from trocar.perception import spheres
from trocar.perception.fiducials import COLORS, JAW, SHAFT, Fixture, Sphere
from trocar.perception.image import Intrinsics, RgbdImage
from trocar.perception.spheres import MAX_POINTS, find_spheres, fit_sphere

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


def photographed(balls, noise_m=0.0):
    """Return an image of balls, (colour, radius, centre) each, before a grey wall."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    depth, color = np.full(u.shape, WALL_M), np.full((*u.shape, 3), 110, np.uint8)
    square = (rays**2).sum(axis=-1)
    for paint, radius_m, center_m in balls:
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


# Colours.


def test_paints_have_the_hues_of_their_colours():
    for name, rgb in COLORS.items():
        assert spheres._hue(name) == round(256 * colorsys.rgb_to_hsv(*rgb)[0])


NEAR = Intrinsics(120, 90, 900.0, 900.0, 59.5, 44.5)
"""A small camera that sees one sphere."""
BALL = Fixture((Sphere(SHAFT, "red", 6e-3, (0.0, 0.0, 0.05)), *FIXTURE.spheres[2:]), (0.0, 0.02, 0.0))
PLACE_M = np.array([0.002, -0.003, 0.45])


def is_found(color=(200, 20, 20), hide=0.0, depth_m=0.45, change=None):
    """Return whether one sphere is found before a grey wall, of whose width a share is hidden by a board."""
    place = PLACE_M * depth_m / 0.45
    v, u = np.mgrid[: NEAR.height, : NEAR.width]
    rays = np.stack([(u - NEAR.cx) / NEAR.fx, (v - NEAR.cy) / NEAR.fy, np.ones(u.shape)], axis=-1)
    along, square = rays @ place, (rays**2).sum(axis=-1)
    inside = along**2 - square * (place @ place - 6e-3**2)
    hit = inside > 0
    depth = np.where(hit, (along - np.sqrt(np.maximum(inside, 0.0))) / square, WALL_M)
    paint = np.where(hit[..., None], color, 110)
    if change is not None:
        depth = np.where(hit, change(depth), depth)
    columns = np.flatnonzero(hit.any(axis=0))
    board = u < columns[0] + hide * len(columns)
    depth, paint = np.where(board, 0.3, depth), np.where(board[..., None], 60, paint)
    found = find_spheres(RgbdImage(paint.astype(np.uint8), depth.astype(np.float32), NEAR), BALL)
    assert np.isnan(found[1:]).all()
    if np.isnan(found[0]).any():
        return False
    assert np.linalg.norm(found[0] - place) < 0.3e-3
    return True


@pytest.mark.parametrize(
    ("color", "found"),
    [
        ((200, 79, 20), True),  # 19.7 deg towards yellow
        ((200, 83, 20), False),  # 21 deg
        ((200, 20, 79), True),  # towards blue, through 0
        ((200, 20, 83), False),
        ((200, 110, 110), True),  # saturation 115 of 255
        ((200, 111, 111), False),
        ((36, 4, 4), True),  # value
        ((35, 4, 4), False),
    ],
)
def test_a_paint_is_known_by_its_hue_where_that_means_something(color, found):
    assert is_found(color) == found


# Shapes.


@pytest.mark.parametrize("depth_m", [0.35, 0.45, 0.55])
def test_a_fifth_of_a_disc_is_enough_and_a_tenth_is_not(depth_m):
    """Circles cut at 74 and 84 % of their width."""
    assert is_found(hide=0.74, depth_m=depth_m)
    assert not is_found(hide=0.86, depth_m=depth_m)


def test_the_smaller_of_two_spheres_of_a_colour_is_as_well_seen_by_a_fifth():
    large = Fixture((Sphere(SHAFT, "red", 9e-3, (0.0, 0.0, 0.09)), *BALL.spheres), BALL.hub_m)
    image = photographed([("red", 6e-3, PLACES_M[1])])
    columns = np.flatnonzero((image.color == np.round(255 * np.array(COLORS["red"]))).all(axis=2).any(axis=0))
    cut = columns[0] + int(0.74 * len(columns))
    image.color[:, :cut], image.depth_m[:, :cut] = 60, 0.3
    found = find_spheres(image, large)
    assert np.isnan(found[0]).all() and np.linalg.norm(found[1] - PLACES_M[1]) < 0.1e-3


def scattered(share, behind_m=4e-3):
    """Return a change that puts so many of the depths behind the sphere, by chance."""
    return lambda depth: depth + np.where(np.random.default_rng(0).random(depth.shape) < share, behind_m, 0.0)


@pytest.mark.parametrize(("share", "found"), [(0.2, True), (0.38, False)])
def test_most_of_what_is_seen_has_to_lie_on_one_sphere(share, found):
    assert is_found(change=scattered(share)) == found


def test_a_blob_has_a_few_hundred_of_its_pixels():
    image = photographed(as_worn())
    red = (image.color == np.round(255 * np.array(COLORS["red"]))).all(axis=2).astype(np.uint8)
    blobs = spheres._blobs(image, red, 6e-3)
    assert len(blobs) == 2
    for points, _ in blobs:
        assert 0.6 * MAX_POINTS < len(points) <= MAX_POINTS


def test_a_blob_that_is_no_sphere_is_none():
    def blobs(change):
        image = photographed([("red", 9e-3, PLACES_M[0])])
        red = (image.color == np.round(255 * np.array(COLORS["red"]))).all(axis=2)
        image.depth_m[red] = change(image.depth_m[red].astype(np.float64))
        return spheres._blobs(image, red.astype(np.uint8), 9e-3)

    rng = np.random.default_rng(0)
    assert len(blobs(lambda depth: depth)) == 1
    assert len(blobs(lambda depth: depth + 0.4e-3 * rng.standard_normal(depth.shape))) == 1
    assert not blobs(lambda depth: depth + 1.2e-3 * rng.standard_normal(depth.shape))
    assert len(blobs(scattered(0.25, 0.05))) == 1
    assert not blobs(scattered(0.45, 0.05))
    assert not blobs(lambda depth: np.full_like(depth, 0.45))


# The fit of one sphere.


CENTER = np.array([0.03, -0.02, 0.55])


def cap(rng, radius_m, count=400, sd_m=0.0, off_share=0.0):
    """Return points of the half of a sphere that faces the origin; the first ones may lie 3 mm too far out."""
    points = rng.standard_normal((4 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points @ CENTER < 0][:count]
    off_m = sd_m * rng.standard_normal((len(points), 1)) + 3e-3 * (np.arange(len(points)) < off_share * count)[:, None]
    return CENTER + (radius_m + off_m) * points


@pytest.mark.parametrize(
    ("points", "good"),
    [
        (cap(np.random.default_rng(0), 8e-3), True),
        (cap(np.random.default_rng(0), 8e-3, off_share=0.28), True),
        (cap(np.random.default_rng(0), 8e-3, off_share=0.32), False),
        (cap(np.random.default_rng(0), 8e-3, sd_m=0.4e-3), True),
        (cap(np.random.default_rng(0), 8e-3, sd_m=0.7e-3), False),
    ],
)
def test_a_sphere_of_known_radius_is_good_if_most_points_lie_on_it(points, good):
    fit = fit_sphere(points, 8e-3, CENTER)
    assert fit is not None and fit.good == good
    assert np.linalg.norm(fit.center_m - CENTER) < 0.2e-3 or not good


def test_blobs_are_assigned_by_size_the_best_pairs_first():
    rough = fit_sphere(cap(np.random.default_rng(0), 8e-3))
    assert rough is not None
    found = {
        size: (cap(np.random.default_rng(0), 8e-3), replace(rough, radius_m=1e-3 * size))
        for size in (5.5, 6.2, 6.7, 8.9)
    }

    def sizes(wanted, *given):
        assigned = spheres._assigned([found[size] for size in given], 1e-3 * np.array(wanted))
        return {sphere: 1e3 * fit.radius_m for sphere, (_, fit) in assigned.items()}

    assert sizes([6.0, 9.0], 8.9, 6.2) == pytest.approx({0: 6.2, 1: 8.9})
    assert sizes([6.0, 9.0], 6.2, 5.5) == pytest.approx({0: 6.2})
    assert sizes([6.0, 6.6], 6.2, 6.7) == pytest.approx({0: 6.2, 1: 6.7})
    assert sizes([6.0, 6.6], 6.7) == pytest.approx({1: 6.7})
    assert sizes([6.0], 6.7, 8.9) == {} == sizes([6.0])


@pytest.mark.parametrize("radius", [None, 0.008])
def test_points_on_a_sphere_give_it_exactly(radius):
    fit = fit_sphere(cap(np.random.default_rng(0), 0.008), radius)
    np.testing.assert_allclose(fit.center_m, CENTER, atol=1e-8)
    assert fit.radius_m == pytest.approx(0.008, abs=1e-8)
    assert fit.share == 1.0 and fit.rms_m < 1e-8


def test_points_between_the_sphere_and_what_is_behind_it_do_not_count():
    rng = np.random.default_rng(1)
    points = cap(rng, 0.008, sd_m=0.15e-3)
    points[:60] += CENTER * rng.uniform(0.01, 0.2, (60, 1))
    fit = fit_sphere(points, 0.008)
    assert np.linalg.norm(fit.center_m - CENTER) < 0.05e-3
    assert 0.8 < fit.share < 0.86
    assert fit.rms_m < 0.2e-3


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.zeros((50, 3)), np.outer(np.linspace(1, 2, 50), CENTER)])
def test_points_that_are_no_sphere_give_none(points):
    assert fit_sphere(points) is None


@pytest.mark.parametrize(("radius_m", "found"), [(0.09, True), (0.12, False)])
def test_what_is_almost_flat_is_no_sphere(radius_m, found):
    fit = fit_sphere(cap(np.random.default_rng(0), radius_m))
    assert (fit is not None) == found
    if fit is not None:
        assert fit.radius_m == pytest.approx(radius_m)


def test_four_points_are_enough():
    points = cap(np.random.default_rng(0), 0.008)[[0, 100, 200, 300]]
    fit = fit_sphere(points, 0.008, CENTER + 1e-4)
    np.testing.assert_allclose(fit.center_m, CENTER, atol=1e-8)
    assert fit_sphere(points[:3], 0.008, CENTER + 1e-4) is None


def out(points, **by_m):
    """Move points k out of the sphere about ``CENTER``: ``p3=0.1e-3`` moves point 3."""
    points = points.copy()
    for name, off_m in by_m.items():
        away = points[int(name[1:])] - CENTER
        points[int(name[1:])] += off_m * away / np.linalg.norm(away)
    return points


def test_points_within_the_gate_count():
    """Of exact points, those nearer than .3 mm; otherwise three SDs of the others', here 3 * 1.4826 * .1 mm."""
    points = out(cap(np.random.default_rng(0), 0.008), p0=0.28e-3, p1=-0.28e-3, p2=0.35e-3, p3=-0.35e-3)
    assert fit_sphere(points, 0.008, CENTER).share == pytest.approx(398 / 400)
    off = cap(np.random.default_rng(0), 0.008)
    off = CENTER + (off - CENTER) * (1 + np.where(np.arange(400) % 2, 1, -1) * 0.1e-3 / 0.008)[:, None]
    off = CENTER + (off - CENTER) * np.where(np.arange(400) < 4, 0.0, 1.0)[:, None]
    off[:4] = cap(np.random.default_rng(0), 0.008)[:4]
    points = out(off, p0=0.41e-3, p1=-0.41e-3, p2=0.48e-3, p3=-0.48e-3)
    assert fit_sphere(points, 0.008, CENTER).share == pytest.approx(398 / 400)


def test_rms_is_that_of_the_points_that_count():
    """Half of them .2 mm off, inward and outward, the others not at all."""
    points = cap(np.random.default_rng(0), 0.008)
    off = np.array([0.0, 0.2e-3, 0.0, -0.2e-3])[np.arange(400) % 4]
    points = CENTER + (points - CENTER) * (1 + off / 0.008)[:, None]
    fit = fit_sphere(points, 0.008)
    assert fit.share == 1.0
    assert fit.rms_m == pytest.approx(0.2e-3 / np.sqrt(2.0), rel=0.02)
