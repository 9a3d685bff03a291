"""Velocity and acceleration from noisy positions are close to those of known signals; joints and tip agree."""

from __future__ import annotations

import time

import numpy as np
import pytest

from known_signals import STEP_S, bang_bang, measured, rms, savitzky_golay, sines
from trocar.arms import ARMS, PSM_CLASSIC, fk
from trocar.errors import TrocarError
from trocar.motion import analysis as module
from trocar.motion.analysis import (
    OVERLAP,
    WINDOW,
    Derivatives,
    JointAnalysis,
    analyse,
    analyse_joints,
    estimate,
    noise_sd,
)

# RMS errors of velocity (rad/s) and acceleration (rad/s^2) that are allowed; found: benchmarks, a quarter less
ALLOWED = {
    ("sines", 1e-5): (0.002, 0.7),
    ("sines", 3e-4): (0.012, 1.2),
    ("sines", 2e-3): (0.032, 1.8),
    ("bang-bang", 1e-5): (0.010, 2.2),
    ("bang-bang", 3e-4): (0.020, 2.9),
    ("bang-bang", 2e-3): (0.060, 5.4),
}
SIGNALS = {"sines": sines(), "bang-bang": bang_bang()}


@pytest.mark.parametrize("outliers", [0.0, 0.01])
@pytest.mark.parametrize(("name", "noise"), ALLOWED)
def test_derivatives_are_found_in_noise_and_outliers(name, noise, outliers):
    known = SIGNALS[name]
    found = estimate(measured(known, noise, outliers), STEP_S)
    velocity, acceleration = ALLOWED[name, noise]
    assert rms(found.velocity - known.velocity) < velocity
    assert rms(found.acceleration - known.acceleration) < acceleration


@pytest.mark.parametrize("name", SIGNALS)
def test_with_outliers_it_beats_the_usual_filter_at_its_best_window(name):
    """The window is chosen by the true error, which nobody knows who needs a filter."""
    known, y = SIGNALS[name], measured(SIGNALS[name], 3e-4, 0.01)
    found = estimate(y, STEP_S)
    tried = [savitzky_golay(y, window) for window in range(5, 60, 2)]
    assert rms(found.velocity - known.velocity) < 0.5 * min(rms(s.velocity - known.velocity) for s in tried)
    assert rms(found.acceleration - known.acceleration) < 0.7 * min(
        rms(s.acceleration - known.acceleration) for s in tried
    )


def test_the_printed_programme_can_meet_every_noisy_sample():
    """Section IV-E: whatever the velocity at the start, no slack is needed, and the noise is all in the motion."""
    known = SIGNALS["sines"]
    q, t = measured(known, 3e-4), STEP_S
    v, a = np.empty(len(q)), np.empty(len(q) - 1)
    v[0] = known.velocity[0]
    for k in range(len(q) - 1):
        a[k] = 2.0 * (q[k + 1] - q[k] - v[k] * t) / t**2
        v[k + 1] = v[k] + a[k] * t
    assert q[:-1] + v[:-1] * t + a * t**2 / 2 == pytest.approx(q[1:], abs=1e-12)
    assert rms(a - known.acceleration[:-1]) > 50 * rms(estimate(q, t).acceleration - known.acceleration)


def test_a_parabola_without_noise_is_found():
    t = STEP_S * np.arange(200)
    found = estimate(1.0 + 2.0 * t + 3.0 * t**2, STEP_S)
    assert found.velocity == pytest.approx(2.0 + 6.0 * t, abs=1e-3)
    assert found.acceleration == pytest.approx(np.full(200, 6.0), abs=1e-2)


def test_missing_samples_are_bridged():
    known = SIGNALS["bang-bang"]
    y = measured(known, 3e-4)
    y[::9] = np.nan
    y[400:406] = np.nan
    found = estimate(y, STEP_S)
    assert rms(found.velocity - known.velocity) < 0.03
    assert np.isfinite(found.acceleration).all()


def test_a_joint_that_stands_still_has_no_velocity():
    found = estimate(np.full(50, 0.3), STEP_S)
    assert (found.position == 0.3).all()
    assert not found.velocity.any() and not found.acceleration.any()


def test_windows_join_without_a_seam():
    """Around the joins, errors are as elsewhere: compared with one window over everything."""
    known = bang_bang(2 * WINDOW)
    y = measured(known, 3e-4)
    found = estimate(y, STEP_S, smoothness=10.0)
    joins = [k * (WINDOW - OVERLAP) + OVERLAP // 2 for k in (1,)]
    for join in joins:
        near = slice(join - 20, join + 20)
        assert rms(found.velocity[near] - known.velocity[near]) < 0.03
        assert np.abs(np.diff(found.velocity[near])).max() < 1.3 * 25.0 * STEP_S


def test_long_recordings_take_time_in_proportion():
    y = measured(bang_bang(24000), 3e-4)
    began = time.process_time()
    estimate(y, STEP_S)
    assert time.process_time() - began < 5.0  # 4 minutes at 100 Hz; .4 s on one quiet core


@pytest.mark.parametrize(
    ("signal", "step_s", "words"),
    [
        (np.zeros(15), 0.01, "16 or more samples"),
        (np.zeros((40, 2)), 0.01, "16 or more samples"),
        (np.r_[np.full(9, np.nan), np.zeros(7)], 0.01, "half of them measured; got .*7 measured"),
        (np.zeros(40), 0.0, "above 0"),
    ],
)
def test_what_is_no_signal_is_refused(signal, step_s, words):
    with pytest.raises(TrocarError, match=words):
        estimate(signal, step_s)
    assert np.isfinite(estimate(np.where(np.arange(16) % 2, np.nan, np.arange(16.0) ** 2), 0.01, 1.0).position).all()


def huber(error):
    """Half the square up to 1.345, straight beyond."""
    return np.where(np.abs(error) <= 1.345, error**2 / 2, 1.345 * np.abs(error) - 1.345**2 / 2)


def test_losses_are_quadratic_near_zero_and_straight_beyond():
    errors = np.array([0.0, 1.0, -1.345, 2.345, -4.0])
    np.testing.assert_allclose(module._huber(errors), huber(errors))
    assert module._huber(np.array([2.345]))[0] - module._huber(np.array([1.345]))[0] == pytest.approx(1.345)


def followed(p0, v0, a):
    """Positions and velocities from the first ones and accelerations that are linear between samples, steps of 1."""
    v = v0 + np.concatenate([[0.0], np.cumsum((a[:-1] + a[1:]) / 2)])
    return p0 + np.concatenate([[0.0], np.cumsum(v[:-1] + (2 * a[:-1] + a[1:]) / 6)]), v


@pytest.mark.parametrize("weight", [0.1, 10.0])
def test_no_motion_nearby_costs_less(weight):
    rng = np.random.default_rng(3)
    n = 20
    scaled = 3 * np.sin(np.arange(n) / 4) + rng.standard_normal(n)
    scaled[[5, 12]] += 15.0, -9.0
    kept = np.ones(n)
    kept[[0, 8]] = 0.0
    p, v, a = module._solve(scaled, weight, kept)

    def cost(p0, v0, pushes):
        errors = kept * (scaled - followed(p0, v0, pushes)[0])
        return huber(errors).sum() + huber(np.sqrt(weight) * np.diff(pushes)).sum()

    again, speeds = followed(p[0], v[0], a)
    np.testing.assert_allclose(p, again, atol=1e-4)
    np.testing.assert_allclose(v, speeds, atol=1e-4)
    least = cost(p[0], v[0], a)
    assert np.abs(scaled - p)[12] > 1.345  # it is straight there
    for size in (1e-2, 0.1):
        for _ in range(60):
            aside = size * rng.standard_normal(n + 2)
            if rng.random() < 0.5:
                aside[2:] = 0.1 * np.cumsum(aside[2:])
            assert cost(p[0] + aside[0], v[0] + aside[1], a + aside[2:]) >= least - 1e-6


def test_the_noise_of_white_samples_is_known_and_outliers_do_not_raise_it():
    rng = np.random.default_rng(0)
    y = 0.02 * rng.standard_normal(40_000)
    assert noise_sd(y) == pytest.approx(0.02, rel=0.02)
    y[::500] += 10.0
    assert noise_sd(y) == pytest.approx(0.02, rel=0.05)
    assert noise_sd(np.arange(50.0) ** 5) == pytest.approx(0.0, abs=1e-6)  # nothing that is smooth counts


def test_cross_validation_looks_where_the_signal_moves_most():
    y = np.zeros(3000)
    y[1200:1900] = np.sin(np.arange(700) / 20)
    found = module._liveliest(y)
    assert found.stop - found.start == 800 and found.start <= 1200 and found.stop >= 1899
    outlier = y.copy()
    outlier[100] = 1e6
    assert module._liveliest(outlier) == found
    assert module._liveliest(y[:800]) == slice(0, 800)
    assert module._liveliest(np.arange(801.0) ** 2) == slice(1, 801)


@pytest.mark.parametrize(
    ("best", "found"), [(1.1, 1.0), (3.4, 3.5), (-0.6, -0.5), (4.2, 4.0), (-9.0, -3.5), (20.0, 7.5)]
)
def test_the_weight_goes_downhill_by_decades_and_then_half_a_decade(monkeypatch, best, found):
    held = []

    def solved(scaled, weight, kept):
        held.append(np.flatnonzero(kept == 0))
        position = scaled + abs(np.log10(weight) - best)
        position[20] = 1e9  # not measured: it must not count
        return position, scaled, scaled

    monkeypatch.setattr(module, "_solve", solved)
    kept = np.ones(40)
    kept[[20, 24]] = 0.0
    scaled = np.zeros(40)
    assert np.log10(module._best_weight(scaled, kept)) == pytest.approx(found)
    assert held[0].tolist() == [3, 10, 17, 20, 24, 31, 38]
    kept[24], scaled[24] = 1.0, -100.0
    kept[22] = 0.0
    assert np.log10(module._best_weight(scaled, kept)) == pytest.approx(found)


@pytest.mark.parametrize(("n", "joins"), [(40, [40]), (49, [49]), (50, [35, 15]), (75, [35, 40]), (100, [35, 30, 35])])
def test_windows_share_half_of_their_overlap(monkeypatch, n, joins):
    monkeypatch.setattr(module, "WINDOW", 40)
    monkeypatch.setattr(module, "OVERLAP", 10)
    solved = []

    def window(scaled, weight, kept):
        solved.append(scaled)
        assert weight == 5.0 and np.array_equal(scaled, kept)
        number = np.full(len(scaled), float(len(solved)))
        return scaled, number, -number

    monkeypatch.setattr(module, "_solve", window)
    p, v, a = module._in_windows(np.arange(n, dtype=float), 5.0, np.arange(n, dtype=float))
    np.testing.assert_array_equal(p, np.arange(n))
    np.testing.assert_array_equal(v, np.repeat(np.arange(len(joins)) + 1.0, joins))
    np.testing.assert_array_equal(a, -v)


def test_units_of_the_signal_and_of_the_time_come_out():
    rng = np.random.default_rng(5)
    y = np.sin(np.arange(60) / 6) + 0.01 * rng.standard_normal(60)
    one = estimate(y, 0.01, 10.0)
    other = estimate(7.0 - 3.0 * y, 0.02, 10.0)
    np.testing.assert_allclose(other.position, 7.0 - 3.0 * one.position, atol=1e-4)
    np.testing.assert_allclose(other.velocity, -3.0 * one.velocity / 2, atol=1e-2)
    np.testing.assert_allclose(other.acceleration, -3.0 * one.acceleration / 4, atol=1.0)
    assert np.abs(one.velocity - np.cos(np.arange(60) / 6) / 6 / 0.01)[3:-3].max() < 1.0


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
