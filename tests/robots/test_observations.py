"""Looks at a wrist, combined: the shift of the instrument is common to all."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, frames
from trocar.perception.instrument import Sighting
from trocar.robots.adaptive import Observation, combine

SHIFT_M = np.array([0.6e-3, -0.3e-3, 0.2e-3])
START = np.array([0.8, 0.0, 0.18, 0.0, 0.0, -0.5])


def observations_of(wrists, rng, left_m=0.2e-3):
    """Return observations at wrists (n, 3) by images each of which leaves one turn and the shift in doubt together."""
    observations = []
    for row, wrist in enumerate(wrists):
        slopes = rng.normal(size=(12, 6)) * np.repeat([1.0, 100.0], 3) / 0.02
        slopes[:, 0] = slopes[:, 3 + row % 3] * 8e-3  # in one image this turn observations like that shift
        information = slopes.T @ slopes
        truth = np.append(wrist, SHIFT_M)
        expected = np.append(wrist + rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.3e-3, 3))
        q = np.append(START[:3], expected[:3])
        pull = information @ (truth - expected)
        observations.append(Observation(row, Sighting(q, expected[3:], information, pull, 500, left_m)))
    return observations


@pytest.fixture
def wrists():
    return np.random.default_rng(0).uniform([-1.0, -0.7, -0.9], [1.0, 0.7, -0.2], (20, 3))


def test_a_common_shift_is_found_and_the_wrists_with_it(wrists):
    q_cmd = np.tile(START, (len(wrists), 1))
    seen = combine(PSM_CLASSIC, "observations", q_cmd, observations_of(wrists, np.random.default_rng(1)))
    assert_allclose(seen.shift_m, SHIFT_M, atol=0.03e-3)
    assert_allclose(seen.recording.q_phy[:, 3:], wrists, atol=0.01)
    assert seen.recording.valid.all() and (seen.sd_rad < 0.5).all()


def test_the_outer_joints_take_the_instrument_to_where_it_is_seen(wrists):
    q_cmd = np.tile(START, (len(wrists), 1))
    seen = combine(PSM_CLASSIC, "observations", q_cmd, observations_of(wrists, np.random.default_rng(1)))
    for q in seen.recording.q_phy:
        asked = np.append(START[:3], q[3:])
        moved = frames(PSM_CLASSIC, q)[6].translation_m - frames(PSM_CLASSIC, asked)[6].translation_m
        assert_allclose(moved, seen.shift_m, atol=0.03e-3)


def test_images_of_something_else_do_not_count(wrists):
    rng, q_cmd = np.random.default_rng(1), np.tile(START, (len(wrists), 1))
    good = observations_of(wrists[:15], rng)
    foreign = [
        Observation(15 + observation.row, observation.sighting)
        for observation in observations_of(wrists[15:] + 0.4, rng, left_m=1e-3)
    ]
    seen = combine(PSM_CLASSIC, "observations", q_cmd, [*good, *foreign])
    assert seen.recording.valid.tolist() == [True] * 15 + [False] * 5


def test_without_looks_nothing_is_said(wrists):
    seen = combine(PSM_CLASSIC, "observations", np.tile(START, (len(wrists), 1)), [])
    assert not seen.shift_m.any() and not seen.recording.valid.any()


def test_what_one_image_tells_of_the_shift_is_weighed_against_how_instruments_usually_lie():
    """As sure as that, it is believed by half; twice by two thirds. A wrist it tells nothing of stays."""
    sure = np.diag([0, 0, 0, *[1 / 0.5e-3**2] * 3])
    q_cmd = np.tile(START, (3, 1))
    observation = Observation(1, Sighting(START, SHIFT_M, sure, np.zeros(6), 500, 0.59e-3))
    once = combine(PSM_CLASSIC, "once", q_cmd, [observation])
    assert_allclose(once.shift_m, SHIFT_M / 2)
    assert_allclose(combine(PSM_CLASSIC, "twice", q_cmd, [observation, observation]).shift_m, SHIFT_M * 2 / 3)
    assert_allclose(once.recording.q_phy[1, 3:], START[3:])
    assert_allclose(once.sd_rad, 1.0)  # a radian where nothing is known
    assert once.recording.valid.tolist() == [False, True, False]
    assert_allclose(once.recording.t_s, [0, 1, 2])


def test_a_sure_image_gives_the_wrist_and_its_uncertainty():
    pull, information = np.array([3.0, -4.0, 5.0, 0, 0, 0]), np.diag([99.0, 399.0, 24.0, 1e12, 1e12, 1e12])
    observation = Observation(0, Sighting(START, np.zeros(3), information, pull, 500, 0.1e-3))
    seen = combine(PSM_CLASSIC, "sure", np.tile(START, (2, 1)), [observation])
    assert_allclose(seen.recording.q_phy[0, 3:] - START[3:], [0.03, -0.01, 0.2])
    assert_allclose(seen.sd_rad, [[0.1, 0.05, 0.2], [1, 1, 1]])
