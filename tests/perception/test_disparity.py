"""Disparity by correlation: finer than a pixel, independent of gain, NaN where there is nothing to match."""

import cv2
import numpy as np
import pytest

from trocar.perception import stereo
from trocar.perception.stereo import disparity_map

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


def coins(level, seed=0, shape=(60, 90)):
    """Return pixels that are brighter or darker by a level, by chance: every window varies about as much."""
    return 100 + level * np.random.default_rng(seed).choice([-1.0, 1.0], shape).astype(np.float32)


def shifted(picture, disparity):
    """Return what the right eye sees: everything so many whole pixels further left."""
    return np.roll(picture, -disparity, axis=1)


def test_it_is_normalised_cross_correlation_with_a_parabola_through_the_best():
    """Against a plain loop over pixels and disparities, of windows 5 px wide."""
    left = texture()[:40, :60]
    right = moved(texture(), 6.3)[:40, :60]
    u, v, wide, high = box = (25, 12, 9, 6)
    found = disparity_map(left, right, box, (3.4, 9.6), 5)
    tried = np.arange(3, 11)
    for row in range(high):
        for column in range(wide):
            at = np.s_[v + row - 2 : v + row + 3]
            one = left[at, u + column - 2 : u + column + 3].ravel()
            others = [right[at, u + column - d - 2 : u + column - d + 3].ravel() for d in tried]
            score = np.array([np.corrcoef(one, other)[0, 1] for other in others])
            k = score.argmax()
            a, b, c = score[k - 1 : k + 2]
            assert found[row, column] == pytest.approx(tried[k] + 0.5 * (a - c) / (a - 2 * b + c), abs=2e-3)


def test_disparities_are_tried_from_the_least_to_the_most_and_one_of_them_needs_neighbours():
    left = coins(20.0)
    box = (30, 20, 20, 12)
    for disparity, tried, is_found in [
        (6, (5.5, 8.2), True),  # 5 to 9
        (8, (5.5, 8.2), True),
        (5, (5.5, 8.2), False),
        (9, (5.5, 8.2), False),
        (5, (4, 6), True),
        (5, (5, 6), False),
        (5, (5, 5), False),
        (0, (-1, 1), True),
        (-3, (-5, 0), True),
    ]:
        found = disparity_map(left, shifted(left, disparity), box, tried)
        assert found.shape == (12, 20)
        if is_found:
            assert np.abs(found - disparity).max() < 0.5
        else:
            assert not np.isfinite(found).any()


def test_the_box_does_not_change_what_is_found_in_it():
    left = texture()
    right = moved(left, 7.4)
    whole = disparity_map(left, right, (40, 20, 100, 80), (5, 10))
    part = disparity_map(left, right, (70, 40, 11, 9), (5, 10), 9)
    inner = np.s_[:, 3:-3]  # beside it lies no pixel that the right picture could take for a better one
    np.testing.assert_allclose(part[inner], whole[20:29, 30:41][inner], atol=1e-3)
    assert np.isfinite(part).all()


def test_beyond_the_pictures_border_its_last_pixels_are_repeated():
    left = texture()
    right = moved(left, 6.3)
    wider = [np.pad(picture, 30, mode="edge") for picture in (left, right)]
    for u, v in ((-3, -2), (180, 105)):
        found = disparity_map(left, right, (u, v, 24, 18), (4, 9))
        expected = disparity_map(*wider, (u + 30, v + 30, 24, 18), (4, 9))
        np.testing.assert_array_equal(found, expected)


def test_a_texture_has_to_stand_out_of_the_noise():
    """Of a grey level and a bit: where it varies by less than noise does, what matches means nothing."""
    for level, share in ((0.9, 1.0), (0.7, 0.0)):
        left = coins(level)
        found = disparity_map(left, shifted(left, 6), (30, 20, 20, 12), (3, 9))
        assert np.isfinite(found).mean() == pytest.approx(share, abs=0.05)


@pytest.mark.parametrize(("noise", "share"), [(20.0, 1.0), (36.0, 0.0)])
def test_windows_have_to_be_alike(noise, share):
    """They correlate by 1 / sqrt(1 + noise^2 / 20^2): by .71 or .49."""
    left = coins(20.0)
    found = disparity_map(left, shifted(left, 6) + coins(noise, 1) - 100, (30, 20, 20, 12), (3, 9), 15)
    assert np.isfinite(found).mean() == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize(("off", "is_found"), [(0, True), (-1, True), (1, True), (-2, False), (2, False)])
def test_both_pictures_agree_to_a_pixel(monkeypatch, off, is_found):
    monkeypatch.setattr(stereo, "_from_right", lambda scores, best: best + off)
    left = coins(20.0)
    found = disparity_map(left, shifted(left, 6), (30, 20, 20, 12), (3, 9))
    assert np.isfinite(found).all() if is_found else not np.isfinite(found).any()


def test_the_right_picture_chooses_among_the_left_pixels_that_meet_it():
    """``scores[k, v, u]`` compares left pixel u with right pixel u - k; beside the box there is none."""
    rng = np.random.default_rng(0)
    scores, best = rng.random((4, 3, 6)).astype(np.float32) - 0.5, rng.integers(0, 4, (3, 6))
    for row in range(3):
        for column in range(6):
            right = column - best[row, column]
            meet = {k: scores[k, row, right + k] for k in range(4) if 0 <= right + k < 6}
            assert stereo._from_right(scores, best)[row, column] == max(meet, key=lambda k: meet[k])
