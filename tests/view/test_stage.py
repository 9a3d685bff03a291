"""Colours of arms that nobody confuses, dashes, and the stretch of a path that belongs to the present goal."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import made_up_replay
from trocar.replay import Goal
from trocar.view.stage import ARMS, CONTACT, DASH_M, MAX_POINTS, TipPath, dashes, stretch_at, stretches_of

REPLAY = made_up_replay(12.0)
SEEN_BY = {
    "most people": np.eye(3),
    "protanopes": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopes": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopes": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as it looks to them (Machado, Oliveira and Fernandes 2009, severity 1)."""


def lab(rgb, seen):
    """Return CIE L*a*b* of a colour (sRGB, 0 to 255) as somebody sees it."""
    share = np.array(rgb) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(seen) @ linear, 0, 1)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.maximum(np.array(to_xyz) @ linear / [0.9505, 1.0, 1.089], 0.008856))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("who", SEEN_BY)
def test_nobody_takes_an_arms_path_for_anothers_or_for_a_contact(who):
    colours = [lab(rgb, SEEN_BY[who]) for rgb in (*ARMS, CONTACT)]
    assert min(np.linalg.norm(a - b) for a, b in combinations(colours, 2)) > 25


def test_dashes_and_gaps_are_equally_long_whatever_the_speed():
    way = np.linspace(0.0, 1.0, 500) ** 2 * 0.1
    pieces = dashes(np.column_stack([way, 0 * way, 0 * way]))
    assert_allclose(pieces[:, 0, 0], np.arange(0.0, 0.1, 2 * DASH_M), atol=1e-6)
    assert_allclose(np.diff(pieces[:-1, :, 0]), DASH_M, atol=1e-6)


def test_a_long_path_has_no_more_dashes_than_can_be_drawn_and_a_resting_tip_has_one():
    line = np.linspace(0.0, 100.0, 5000)
    assert len(dashes(np.column_stack([line, line, line]))) <= MAX_POINTS / 2 + 1
    assert dashes(np.zeros((7, 3))).shape == (1, 2, 3)


def test_an_arm_turns_to_something_else_where_its_own_goals_begin_and_end():
    goals = (Goal("psm1", 0, 1.0, 4.0), Goal("psm2", 0, 2.0, 5.0), Goal("psm1", 1, 6.0, 99.0))
    times_s = stretches_of(replace(REPLAY, goals=goals), "psm1")
    assert times_s.tolist() == [0.0, 1.0, 4.0, 6.0, 12.0]
    for time_s, stretch in ((0.0, (0, 1)), (1.0, (1, 4)), (3.99, (1, 4)), (5.0, (4, 6)), (12.0, (6, 12))):
        assert stretch_at(times_s, time_s) == stretch
    assert stretches_of(replace(REPLAY, goals=()), "psm1").tolist() == [0.0, 12.0]


def test_a_stretch_of_a_path_begins_and_ends_exactly_at_its_times():
    points = REPLAY.tools["psm1"].p_world_driven_m
    part = TipPath(REPLAY.times_s, points).between(2.0, 4.33)
    assert_allclose(part[[0, -1]], points[[200, 433]])
    assert_allclose(TipPath(REPLAY.times_s, points).between(5.02, 5.02), points[[502, 502]])
