"""Signals whose derivatives are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

STEP_S = 0.01
FINE = 20
"""Integration steps per sample: accelerations change between samples."""


@dataclass(frozen=True)
class Known:
    """Position, velocity and acceleration (n,) at 100 Hz."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def sines(samples: int = 1200) -> Known:
    """Return the sum of two sines, of .8 and 2 Hz, which neither starts nor ends at rest."""
    t = STEP_S * np.arange(samples)
    found = [np.zeros(samples) for _ in range(3)]
    for size, hz, phase in ((0.5, 0.8, 0.0), (0.2, 2.0, 1.0)):
        w = 2 * np.pi * hz
        found[0] += size * np.sin(w * t + phase)
        found[1] += size * w * np.cos(w * t + phase)
        found[2] -= size * w**2 * np.sin(w * t + phase)
    return Known(*found)


def bang_bang(samples: int = 1200, seed: int = 3, largest: float = 25.0) -> Known:
    """Return motions from rest to rest at the largest acceleration, with pauses and stretches of constant speed."""
    rng = np.random.default_rng(seed)
    a = np.zeros(samples * FINE)
    at = 20 * FINE
    while at < (samples - 150) * FINE:
        half, even = rng.integers(10 * FINE, 30 * FINE), rng.integers(0, 20 * FINE)
        size = rng.choice([-1.0, 1.0]) * largest
        a[at : at + half], a[at + half + even : at + 2 * half + even] = size, -size
        at += 2 * half + even + rng.integers(0, 30 * FINE)
    h = STEP_S / FINE
    v = np.concatenate([[0.0], np.cumsum(a)[:-1] * h])
    p = np.concatenate([[0.0], np.cumsum(v * h + a * h * h / 2)[:-1]])
    return Known(p[::FINE], v[::FINE], a[::FINE])


def measured(known: Known, noise: float, outliers: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return noisy positions; a share of them, the outliers, lies .03 off."""
    rng = np.random.default_rng(seed)
    y = known.position + noise * rng.standard_normal(len(known.position))
    wrong = rng.random(len(y)) < outliers
    return y + 0.03 * wrong * rng.choice([-1.0, 1.0], len(y))


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def savitzky_golay(signal: np.ndarray, samples: int = 21) -> Known:
    """Return the motion by cubics fitted in a sliding window (Savitzky and Golay 1964), at 100 Hz."""
    return Known(*(savgol_filter(signal, samples, 3, deriv=order, delta=STEP_S) for order in range(3)))
