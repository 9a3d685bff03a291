"""Outlines that are cut between their notches."""

import cv2
import numpy as np

from trocar.tasks.debridement.perception.outlines import solidity, split_convex


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
