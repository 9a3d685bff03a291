"""Velocity and acceleration from noisy positions are close to those of known signals."""

import time

import numpy as np
import pytest

from known_signals import STEP_S, bang_bang, measured, rms, sines
from trocar.errors import TrocarError
from trocar.motion.analysis import estimate, savitzky_golay
from trocar.motion.analysis.huber import OVERLAP, WINDOW, noise_sd

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
    tried = [savitzky_golay(y, STEP_S, window) for window in range(5, 60, 2)]
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


def test_the_usual_filter_is_exact_on_a_parabola():
    t = STEP_S * np.arange(100)
    found = savitzky_golay(1.0 + 2.0 * t + 3.0 * t**2, STEP_S)
    assert found.velocity == pytest.approx(2.0 + 6.0 * t)
    assert found.acceleration == pytest.approx(np.full(100, 6.0))


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


def test_the_noise_is_estimated_whatever_moves():
    rng = np.random.default_rng(1)
    for known in SIGNALS.values():
        y = known.position + 1e-3 * rng.standard_normal(len(known.position))
        assert noise_sd(y) == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize(
    ("signal", "step_s", "words"),
    [
        (np.zeros(5), 0.01, "16 or more samples"),
        (np.zeros((40, 2)), 0.01, "16 or more samples"),
        (np.r_[np.full(30, np.nan), np.zeros(10)], 0.01, "half of them measured"),
        (np.zeros(40), 0.0, "above 0"),
    ],
)
def test_what_is_no_signal_is_refused(signal, step_s, words):
    with pytest.raises(TrocarError, match=words):
        estimate(signal, step_s)
