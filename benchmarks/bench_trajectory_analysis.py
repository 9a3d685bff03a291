"""Errors of estimated velocity and acceleration on signals with known derivatives, and how long it takes.

    python benchmarks/bench_trajectory_analysis.py

Two sines (.8 and 2 Hz), and motions at the largest acceleration (25 rad/s^2) from rest to rest; 12 s at 100 Hz. The
Savitzky-Golay filter is shown with its usual window of 21 samples and with the best of all odd windows from 5 to 59,
chosen for each column by the true error, which is unknown in practice.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from known_signals import STEP_S, Known, bang_bang, measured, rms, savitzky_golay, sines
from trocar.motion.analysis import estimate

NOISES_RAD = (1e-5, 3e-4, 2e-3)
SEEDS = range(5)


def main() -> None:
    print("RMS errors of velocity (rad/s) and acceleration (rad/s^2), mean of 5 seeds of noise")
    print(f"{'signal':10} {'noise':>6} {'off':>4}   {'Huber QP':>15}   {'S-G, 21':>15}   {'S-G, best':>15}")
    for name, known in (("sines", sines()), ("bang-bang", bang_bang())):
        for noise in NOISES_RAD:
            for outliers in (0.0, 0.01):
                print(line(name, known, noise, outliers))
    print(timing())


def line(name: str, known: Known, noise: float, outliers: float) -> str:
    errors: dict[str, list[tuple[float, float]]] = {"qp": [], "21": [], "best": []}
    for seed in SEEDS:
        y = measured(known, noise, outliers, seed)
        errors["qp"].append(error(known, estimate(y, STEP_S)))
        errors["21"].append(error(known, savitzky_golay(y)))
        tried = [error(known, savitzky_golay(y, window)) for window in range(5, 60, 2)]
        errors["best"].append((min(v for v, _ in tried), min(a for _, a in tried)))
    found = "   ".join("{:7.4f} {:7.3f}".format(*np.mean(values, axis=0)) for values in errors.values())
    return f"{name:10} {noise:6.0e} {100 * outliers:3.0f}%   {found}"


def error(known: Known, motion: object) -> tuple[float, float]:
    return (
        rms(motion.velocity - known.velocity),  # type: ignore[attr-defined]
        rms(motion.acceleration - known.acceleration),  # type: ignore[attr-defined]
    )


def timing() -> str:
    minutes = 10
    y = measured(bang_bang(6000 * minutes), 3e-4)
    began = time.perf_counter()
    estimate(y, STEP_S)
    return f"one joint, {minutes} minutes at 100 Hz: {time.perf_counter() - began:.1f} s"


if __name__ == "__main__":
    main()
