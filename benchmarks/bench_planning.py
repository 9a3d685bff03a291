"""Planning time of Algorithm 2 on the recorded transfers, beside a plain loop over durations and joints.

Run: .venv/bin/python benchmarks/bench_planning.py; the recordings: TROCAR_DATA, or shared/data beside
the repository.
"""

import os
from pathlib import Path

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS
from trocar.motion import assess_transfer, plan_transfer, splines
from trocar.motion.cubic import CubicGrid

ARM, LIMITS = ARMS["psm-classic"], MOTION_LIMITS["paper"]
SLACK = 0.02  # recorded waypoints lie up to 0.3 mm beyond the nominal insertion
REPEATS = 20


class PlainGrid(CubicGrid):
    """The same search, one batch, segment, duration and joint at a time."""

    def shortest(self, velocities):
        """Return what CubicGrid.shortest returns."""
        out = np.full((len(velocities), len(self.step_q)), np.inf)
        for b, at in enumerate(velocities):
            for k, step in enumerate(self.step_q):
                for t in self.times_s[:-1]:
                    if all(self._keeps(j, t, step[j], at[k, j], at[k + 1, j]) for j in range(len(step))):
                        out[b, k] = t
                        break
        return out

    def _keeps(self, joint, t, step, v0, v1):
        a = (v1 + v0) / t**2 - 2 * step / t**3
        b = (v1 - v0) / (2 * t) - 1.5 * a * t
        acceleration = max(abs(2 * b), abs(6 * a * t + 2 * b))
        speed = max(abs(v0), abs(v1))
        if a != 0 and 0 < -b / (3 * a) < t:
            speed = max(speed, abs(v0 - b * b / (3 * a)))
        return acceleration <= self.limits.acceleration[joint] and speed <= self.limits.velocity[joint]


def timed(waypoints, repeats):
    """Return the planning time (motions, repeats) in ms, and the plans."""
    times = np.zeros((len(waypoints), repeats))
    plans = []
    for index, four in enumerate(waypoints):
        for repeat in range(repeats):
            plan = plan_transfer(ARM, four, LIMITS, range_slack=SLACK)
            times[index, repeat] = plan.compute_ms
        plans.append(plan)
    return times, plans


def main():
    data = Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))
    with np.load(data / "dvrk/motion/reference_waypoints.npz") as recorded:
        waypoints, samples = recorded["waypoints"], recorded["cubic_samples"]
    timed(waypoints[:1], 3)
    fast, plans = timed(waypoints, REPEATS)
    splines.CubicGrid = PlainGrid
    plain, plain_plans = timed(waypoints[:2], 1)
    splines.CubicGrid = CubicGrid
    quality = [assess_transfer(ARM, plan, LIMITS) for plan in plans]
    lengths = np.array([round(100 * q.duration_s) for q in quality])
    same = [a.trajectory.duration_s == b.trajectory.duration_s for a, b in zip(plain_plans, plans, strict=False)]
    print(f"recorded length minus planned, samples of 10 ms: {(samples - lengths).tolist()}")
    print(
        f"mean duration {np.mean([q.duration_s for q in quality]):.3f} s, "
        f"bound {np.mean([q.bound_s for q in quality]):.3f} s"
    )
    print(
        f"largest ratios: velocity {max(q.max_velocity_ratio for q in quality):.6f}, "
        f"acceleration {max(q.max_acceleration_ratio for q in quality):.6f}"
    )
    print(f"off the vertical: up to {1e3 * max(q.vertical_deviation_m for q in quality):.2f} mm")
    p50, p95 = np.percentile(fast, [50, 95])
    least = fast.min()
    print(f"a plan: least {least:.2f} ms, p50 {p50:.2f} ms, p95 {p95:.2f} ms (target 5 ms)")
    slower = plain.mean() / p50
    print(f"plain loop: {plain.mean():.0f} ms, {slower:.0f} times slower; same durations: {all(same)}")


if __name__ == "__main__":
    main()
