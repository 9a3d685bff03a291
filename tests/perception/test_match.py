"""Disparity by correlation: finer than a pixel, independent of gain, NaN where there is nothing to match."""

import cv2
import numpy as np

from trocar.perception.hue import RED_FOAM, HueRange, to_hsv
from trocar.perception.match import disparity_map

BOX = (60, 40, 50, 30)


def texture(seed=0):
    noise = np.random.default_rng(seed).standard_normal((120, 200)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5) * 120 + 120


def moved(picture, disparity):
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
    return cv2.remap(picture, u + np.float32(disparity), v, cv2.INTER_CUBIC)


def test_a_shift_is_found_to_a_tenth_of_a_pixel_whatever_the_gain():
    left = texture()
    for disparity in (7.0, 9.3, 11.6):
        noise = np.random.default_rng(1).normal(0, 1.5, left.shape).astype(np.float32)
        found = disparity_map(left, 0.8 * moved(left, disparity) + 5 + noise, BOX, (4, 15))
        assert np.isfinite(found).mean() > 0.95
        assert abs(np.nanmedian(found) - disparity) < 0.05
        assert np.nanstd(found) < 0.1


def test_a_slope_is_followed():
    left = texture()
    v, u = np.mgrid[:120, :200].astype(np.float32)
    slope = 6 + 0.05 * (u - 60)
    right = cv2.remap(left, u + slope, v, cv2.INTER_CUBIC)  # at the right pixel's own place
    found = disparity_map(left, right, BOX, (2, 14))
    at = np.arange(50) + 60
    expected = 6 + 0.05 * (at - 60 - (6 + 0.05 * (at - 60)) / 1.05)
    assert np.nanmedian(np.abs(found - expected[None])) < 0.15


def test_what_is_not_there_is_not_matched():
    assert np.isfinite(disparity_map(texture(0), texture(1), BOX, (4, 15))).mean() < 0.15
    flat = np.full((120, 200), 100.0, np.float32)
    assert not np.isfinite(disparity_map(flat, flat, BOX, (4, 15))).any()
    assert not np.isfinite(disparity_map(texture(), texture(), BOX, (4, 15))).all()


def test_the_best_place_at_the_end_of_the_range_does_not_count():
    left = texture()
    assert np.isfinite(disparity_map(left, moved(left, 20.0), BOX, (4, 12))).mean() < 0.2


def test_hues_go_round():
    picture = np.array(
        [[[200, 20, 20], [200, 20, 40], [200, 120, 20], [20, 20, 200], [60, 8, 8], [30, 5, 5]]], np.uint8
    )
    assert (RED_FOAM.mask(to_hsv(picture))[0] > 0).tolist() == [True, True, False, False, True, False]
    blue = HueRange.around((0.02, 0.14, 0.62))
    assert (blue.mask(to_hsv(picture))[0] > 0).tolist() == [False, False, False, True, False, False]
