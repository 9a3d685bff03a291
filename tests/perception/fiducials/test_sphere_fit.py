"""Spheres through points on their near side."""

import numpy as np
import pytest

from trocar.perception.fiducials.sphere_fit import fit_sphere

CENTER = np.array([0.03, -0.02, 0.55])


def cap(rng, radius_m, count=400, sd_m=0.0):
    """Return points of the half of a sphere that faces the origin."""
    points = rng.standard_normal((4 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points @ CENTER < 0][:count]
    return CENTER + (radius_m + sd_m * rng.standard_normal((len(points), 1))) * points


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


def test_the_radius_tells_spheres_of_16_and_17_mm_apart():
    rng = np.random.default_rng(2)
    found = [fit_sphere(cap(rng, r, sd_m=0.15e-3)).radius_m for r in (0.008, 0.0085)]
    assert np.abs(np.array(found) - [0.008, 0.0085]).max() < 0.1e-3


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
