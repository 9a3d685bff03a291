"""Closed-form inverse kinematics compared with SciPy's numeric solution, in one run, on the same poses.

Run: python benchmarks/bench_kinematics.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from trocar.arms import ARMS, ArmModel, fk, ik
from trocar.geometry import SE3

NUMERIC_POSES = 20
SCALAR_POSES = 200
BATCH_POSES = 16_384
REPEATS = 200  # the minimum over short windows excludes other work on the machine
CHECKED_POSES = 100_000
START_RAD = 0.1  # the numeric solver starts this close to the solution (insertion: a tenth of it, in m)
TARGET_SCALAR_US, TARGET_BATCH_US, TARGET_RATIO = 5.0, 0.15, 100.0


def numeric_ik(arm: ArmModel, T: SE3, start: np.ndarray) -> np.ndarray:
    """Return the solution by SciPy's least squares on the pose error, with the joint limits as bounds."""

    def error(q: np.ndarray) -> np.ndarray:
        difference = fk(arm, q).matrix[:3] - T.matrix[:3]
        return difference.ravel()

    return least_squares(
        error, start, bounds=(arm.lower, arm.upper), x_scale="jac", xtol=1e-12, ftol=1e-15, gtol=1e-15
    ).x


def best_us(work: Callable[[], object], count: int, repeats: int) -> tuple[float, float]:
    """Return minimum and median time per item, in microseconds."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) / count * 1e6, float(np.median(times)) / count * 1e6


def measure(arm: ArmModel) -> bool:
    """Print the times for one arm and return whether they meet the targets."""
    rng = np.random.default_rng(0)
    q = rng.uniform(arm.lower, arm.upper, (CHECKED_POSES, 6))
    T = fk(arm, q)
    error = np.abs(fk(arm, ik(arm, T, q)).matrix - T.matrix).max()
    many = T[:BATCH_POSES]
    poses, near = [T[i] for i in range(SCALAR_POSES)], list(q[:SCALAR_POSES])
    scale = START_RAD * np.array([1, 1, 0.1, 1, 1, 1])
    starts = q[:NUMERIC_POSES] + scale * rng.uniform(-1, 1, (NUMERIC_POSES, 6))
    starts = np.clip(starts, arm.lower + 1e-6, arm.upper - 1e-6)

    scalar = best_us(lambda: [ik(arm, a, b) for a, b in zip(poses, near, strict=True)], SCALAR_POSES, REPEATS)
    batch = best_us(lambda: ik(arm, many), BATCH_POSES, REPEATS)
    numeric = best_us(lambda: [numeric_ik(arm, a, b) for a, b in zip(poses, starts, strict=False)], NUMERIC_POSES, 3)
    ratio = numeric[0] / scalar[0]
    print(f"{arm.name}: largest error of FK(IK(T)) over {CHECKED_POSES} poses {error:.1e}")
    print(f"  one call   {scalar[0]:9.2f} ({scalar[1]:.2f})   target {TARGET_SCALAR_US}")
    print(f"  batched    {batch[0]:9.3f} ({batch[1]:.3f})  target {TARGET_BATCH_US}")
    print(f"  SciPy      {numeric[0]:9.0f} ({numeric[1]:.0f})   {ratio:.0f} times one call; target {TARGET_RATIO:.0f}")
    return bool(scalar[0] <= TARGET_SCALAR_US and batch[0] <= TARGET_BATCH_US and ratio >= TARGET_RATIO)


def main() -> int:
    """Measure every arm."""
    print("inverse kinematics, microseconds per pose: minimum (median) of the repeats")
    met = all([measure(arm) for arm in ARMS.values()])
    print("all targets met" if met else "not all targets met")
    return 0


if __name__ == "__main__":
    sys.exit(main())
