"""What looks at blocks in the jaws tell about where the tip is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated import ideal_laboratory, standing
from trocar.tasks.peg_transfer.agents.offset import NOISE_M, TipOffset
from trocar.tasks.peg_transfer.agents.unilateral import Unilateral
from two_armed import briefed


def learned(true_m, angles_rad, noise_m=0.0, seed=0):
    """Return an offset after a look at a wall at each of these angles: seen where it is, but for noise across it."""
    rng, offset = np.random.default_rng(seed), TipOffset()
    for angle in angles_rad:
        across = np.array([np.cos(angle), np.sin(angle)])
        along = np.array([-np.sin(angle), np.cos(angle)])
        left = np.asarray(true_m) - offset.xy_m  # of the offset, by which the block is seen off
        seen = across * (across @ left + noise_m * rng.standard_normal()) + along * rng.normal(0.0, 2e-3)
        offset.learn(across, seen)
    return offset.xy_m


@given(x=st.floats(-2e-3, 2e-3), y=st.floats(-2e-3, 2e-3), first=st.floats(0.0, 6.28), seed=st.integers(0, 99))
@settings(max_examples=50, deadline=None)
def test_walls_at_different_angles_tell_both_components(x, y, first, seed):
    angles = first + np.radians([0.0, 120.0, 240.0] * 40)
    assert np.abs(learned((x, y), angles, NOISE_M, seed) - (x, y)).max() < 4 * NOISE_M / np.sqrt(60) + 0.02 * np.hypot(
        x, y
    )


def test_walls_at_one_angle_tell_nothing_about_what_is_along_them():
    x_m, y_m = learned((1e-3, 1e-3), [0.0] * 20)
    assert x_m == pytest.approx(1e-3, rel=0.1) and y_m == pytest.approx(0.0, abs=1e-12)


def test_one_look_is_believed_about_half():
    x_m, _ = learned((1e-3, 0.0), [0.0])
    assert 0.4e-3 < x_m < 0.7e-3


def test_the_tip_is_believed_where_the_offset_has_it():
    motions = Unilateral(briefed(ideal_laboratory(standing(0)))).arm.motions
    q, before = motions._model.middle, None
    before = motions.tip(q)
    for _ in range(200):
        motions.offset.learn(np.array([1.0, 0.0]), np.array([1e-3 - motions.offset.xy_m[0], 0.0]))
    moved_m = motions.tip(q).translation_m - before.translation_m
    assert moved_m == pytest.approx([motions.offset.xy_m[0], 0.0, 0.0], abs=1e-12)
    assert motions.offset.xy_m[0] == pytest.approx(1e-3, rel=0.02)
    assert np.abs(motions.ik(motions.tip(q)) - q).max() < 1e-9
