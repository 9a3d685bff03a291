"""Closed-form inverse kinematics beside SciPy's numeric one, in one run, on the same poses.

Run: python benchmarks/bench_kinematics.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from trocar.arms import ARMS, ArmModel, fk, ik, ik_floats
from trocar.geometry import SE3

NUMERIC_POSES = 20
SCALAR_POSES = 2000
BATCH_POSES = 100_000
START_RAD = 0.1  # the numeric solver starts this near to the answer (m for the insertion: a tenth)
TARGET_SCALAR_US, TARGET_BATCH_US, TARGET_RATIO = 5.0, 0.15, 100.0


def numeric_ik(arm: ArmModel, T: SE3, start: np.ndarray) -> np.ndarray:
    """SciPy's least squares on the pose error, with the joint limits as bounds."""

    def error(q: np.ndarray) -> np.ndarray:
        difference = fk(arm, q).matrix[:3] - T.matrix[:3]
        return difference.ravel()

    return least_squares(
        error, start, bounds=(arm.lower, arm.upper), x_scale="jac", xtol=1e-12, ftol=1e-15, gtol=1e-15
    ).x


def best_us(work: Callable[[], object], count: int, repeats: int) -> tuple[float, float]:
    """Least and median time per item, in microseconds."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) / count * 1e6, float(np.median(times)) / count * 1e6


def main() -> int:
    met = True
    print("inverse kinematics, microseconds a pose: least (median) of the repeats")
    for arm in ARMS.values():
        rng = np.random.default_rng(0)
        q = rng.uniform(arm.lower, arm.upper, (BATCH_POSES, 6))
        T = fk(arm, q)
        error = np.abs(fk(arm, ik(arm, T, q)).matrix - T.matrix).max()
        few, near = [T[i] for i in range(SCALAR_POSES)], list(q[:SCALAR_POSES])
        lists = [pose.matrix.ravel().tolist() for pose in few]
        near_lists = [row.tolist() for row in near]
        scalar, scalar_median = best_us(
            lambda: [ik(arm, a, b) for a, b in zip(few, near, strict=True)], SCALAR_POSES, 25
        )
        floats, floats_median = best_us(
            lambda: [ik_floats(arm, a, b) for a, b in zip(lists, near_lists, strict=True)], SCALAR_POSES, 25
        )
        batch, batch_median = best_us(lambda: ik(arm, T), BATCH_POSES, 25)
        scale = START_RAD * np.array([1, 1, 0.1, 1, 1, 1])
        starts = np.clip(
            q[:NUMERIC_POSES] + scale * rng.uniform(-1, 1, (NUMERIC_POSES, 6)), arm.lower + 1e-6, arm.upper -
            1e-6
        )
        numeric, numeric_median = best_us(
            lambda: [numeric_ik(arm, T[i], starts[i]) for i in range(NUMERIC_POSES)], NUMERIC_POSES, 3
        )
        print(f"{arm.name}: largest error of FK(IK(T)) over {BATCH_POSES} poses {error:.1e}")
        print(f"  one call   {scalar:9.2f} ({scalar_median:.2f})   target {TARGET_SCALAR_US}")
        print(f"  on floats  {floats:9.2f} ({floats_median:.2f})")
        print(f"  batched    {batch:9.3f} ({batch_median:.3f})  target {TARGET_BATCH_US}")
        print(
            f"  SciPy      {numeric:9.0f} ({numeric_median:.0f})   {numeric / scalar:.0f} times one call; target {TARGET_RATIO:.0f}"
        )
        met &= scalar <= TARGET_SCALAR_US and batch <= TARGET_BATCH_US and numeric >= TARGET_RATIO * scalar
    print("all targets met" if met else "not all targets met")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
