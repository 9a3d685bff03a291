"""Joints and tip of an arm move consistently."""

import numpy as np
import pytest

from known_signals import STEP_S, measured, rms, sines
from trocar.arms import ARMS, PSM_CLASSIC, fk
from trocar.errors import TrocarError
from trocar.motion.analysis import Derivatives, JointAnalysis, analyse, analyse_joints

T_S = STEP_S * np.arange(600)


def moving(arm):
    """Return joints that wave around the middle of their ranges, (600, 6)."""
    rate = np.array([1.1, 0.7, 0.9, 2.0, 2.6, 3.1])
    size = np.array([0.2, 0.15, 0.02, 0.4, 0.3, 0.3])
    return 0.5 * (arm.lower + arm.upper) + size * (1.0 - np.cos(np.outer(T_S, rate)))


@pytest.mark.parametrize("name", ARMS)
def test_the_tips_motion_is_that_of_its_positions(name):
    arm = ARMS[name]
    q = moving(arm)
    found = analyse_joints(arm, q, STEP_S)
    p = fk(arm, q).translation_m
    inner = slice(5, -5)
    velocity, acceleration = np.gradient(p, STEP_S, axis=0), np.diff(p, 2, axis=0) / STEP_S**2
    assert found.tip.velocity[inner] == pytest.approx(velocity[inner], abs=1e-3)
    assert rms(found.tip.acceleration[1:-1][inner] - acceleration[inner]) < 0.02 * rms(acceleration)
    assert found.path_m == pytest.approx(np.linalg.norm(np.diff(p, axis=0), axis=1).sum(), rel=1e-4)


def test_jerk_is_the_difference_of_accelerations():
    known = sines()
    found = analyse(measured(known, 0.0)[:, None], STEP_S)
    assert found.jerk.shape == (len(known.position) - 1, 1)
    assert found.jerk[:, 0] == pytest.approx(np.diff(found.acceleration[:, 0]) / STEP_S)
    truth = np.diff(known.acceleration) / STEP_S
    assert rms(found.jerk[20:-20, 0] - truth[20:-20]) < 0.2 * rms(truth)


def test_sizes_are_those_of_a_sine():
    t = STEP_S * np.arange(1000)
    found = analyse(np.sin(2 * np.pi * t)[:, None], STEP_S)
    assert found.rms()["velocity"][0] == pytest.approx(2 * np.pi / np.sqrt(2), rel=0.01)
    assert found.largest()["velocity"][0] == pytest.approx(2 * np.pi, rel=0.01)


def test_signals_without_columns_are_refused():
    with pytest.raises(TrocarError, match="samples, signals"):
        analyse(np.zeros(40), STEP_S)
    with pytest.raises(TrocarError):
        analyse_joints(PSM_CLASSIC, np.zeros((40, 5)), STEP_S)


def test_sizes_of_rows_that_are_known_by_hand():
    """Two signals at four instants, .5 s apart."""
    velocity = np.array([[3.0, 0.0], [-4.0, 0.0], [0.0, 2.0], [0.0, -2.0]])
    acceleration = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, -1.0], [0.0, -1.0]])
    found = Derivatives(0 * velocity, velocity, acceleration, 0.5)
    np.testing.assert_allclose(found.jerk, [[2.0, 0.0], [4.0, -2.0], [-8.0, 0.0]])
    rms_values, largest = found.rms(), found.largest()
    np.testing.assert_allclose(rms_values["velocity"], [2.5, np.sqrt(2)])
    np.testing.assert_allclose(rms_values["acceleration"], [np.sqrt(21 / 4), np.sqrt(0.5)])
    np.testing.assert_allclose(rms_values["jerk"], [np.sqrt(84 / 3), np.sqrt(4 / 3)])
    assert [largest[name].tolist() for name in ("velocity", "acceleration", "jerk")] == [[4, 2], [4, 1], [8, 2]]


def test_the_length_of_a_path_is_that_of_its_steps():
    tip = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12]])
    still = Derivatives(tip, 0 * tip, 0 * tip, 0.1)
    assert JointAnalysis(still, still).path_m == pytest.approx(17.0)
