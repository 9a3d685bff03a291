"""The cables between encoder and joint, and what they do not repeat."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.plant import PLANTS
from trocar.sim.session import SAMPLE_S, T_WORLD_BASE, Session, record_motion
from trocar.sim.transmission import CORRELATION_TIME_S, UNREPEATABLE_SHARE, Transmission

ARM = ARMS["psm-classic"]
STEP_S = 0.1
FORGET = np.array([0.0, 0.0, 0.0, 0.4, 0.4, 0.4])
"""A swing wider than any backlash: afterwards the slack does not depend on where it was."""


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_repeats_is_the_plant(plant, seed):
    rng = np.random.default_rng(seed)
    path = random_smooth_path(ARM, rng, 60)
    swing = path[:1] + np.array([[0.0], [1.0], [-1.0], [0.0]]) * FORGET
    whole = np.concatenate([swing, path])
    transmission = Transmission(plant, whole[0], rng, unrepeatable=False)
    joints = []
    for q in whole:
        transmission.advance(SAMPLE_S)
        joints.append(transmission.joints(q))
    assert np.abs(np.array(joints) - plant.run(whole))[3:].max() < 1e-12


def test_slack_is_unknown_at_the_start_and_never_wider_than_the_backlash():
    plant = PLANTS["psm1_grey"]
    q = np.array([0.8, 0.0, 0.18, 0.0, 0.0, 0.0])
    starts = [Transmission(plant, q, np.random.default_rng(s), unrepeatable=False).joints(q) for s in range(200)]
    error = np.array(starts)[:, 3:] - q[3:] - plant.offset
    widest = np.abs(plant.C) @ plant.radii
    assert (np.abs(error) <= widest + 1e-12).all()
    assert (np.abs(error).max(axis=0) > 0.5 * widest).all()


@pytest.fixture(scope="module")
def wander():
    """The unrepeatable error (n, 6) over 4000 s, in units of the identified SD."""
    plant = PLANTS["psm1_grey"]
    q = np.array([0.8, 0.0, 0.18, 0.0, 0.0, 0.0])
    transmission = Transmission(plant, q, np.random.default_rng(3))
    repeatable = transmission.joints(q) - transmission._drift
    rows = []
    for _ in range(40000):
        transmission.advance(STEP_S)
        rows.append(transmission.joints(q) - repeatable)
    return np.array(rows) / plant.noise_sd


def test_the_unrepeatable_part_has_its_share_of_the_identified_spread(wander):
    assert np.allclose(wander.std(axis=0), UNREPEATABLE_SHARE, rtol=0.12)
    assert np.abs(wander.mean(axis=0)).max() < 0.15


def test_the_unrepeatable_part_is_smooth_and_fades_within_seconds(wander):
    def correlation(lag_s):
        lag = round(lag_s / STEP_S)
        return np.mean(wander[lag:] * wander[:-lag], axis=0) / np.mean(wander**2, axis=0)

    t = np.array([0.1, 1.0, 6.0])
    expected = (1.0 + t / CORRELATION_TIME_S) * np.exp(-t / CORRELATION_TIME_S)
    measured = np.array([correlation(lag) for lag in t]).mean(axis=1)
    assert np.allclose(measured, expected, atol=0.06)


def test_the_joints_wander_independently(wander):
    assert np.abs(np.corrcoef(wander.T) - np.eye(6)).max() < 0.15


def test_a_recording_scatters_as_the_identified_arm_does():
    plant = PLANTS["psm1_grey"]
    arms = dict.fromkeys(T_WORLD_BASE, ARM)
    session = Session(arms, dict.fromkeys(arms, plant), T_WORLD_BASE, T_WORLD_BASE)
    recording = record_motion(session, "psm1", np.random.default_rng(1))
    residual = (recording.q_phy - plant.run(recording.q_cmd))[recording.valid]
    assert np.allclose(residual.std(axis=0), plant.noise_sd, rtol=0.15)
    assert np.abs(residual[:30].mean(axis=0)[3:]).max() < 0.02
    again = record_motion(session, "psm1", np.random.default_rng(1))
    assert np.array_equal(again.q_phy, recording.q_phy)
