"""Planning: recorded transfers by every planner, Algorithm 2 beside a plain loop, moving starts, distances of two arms.

Run: .venv/bin/python benchmarks/bench_planning.py; the recordings: TROCAR_DATA, or shared/data beside
the repository.
"""

import os
import time
from pathlib import Path

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS, ik
from trocar.geometry import SE3, SO3
from trocar.motion import (
    PLANNERS,
    ArmMotion,
    MotionProblem,
    MovingArm,
    limit_use,
    move_to,
    plan_motion,
    splines,
    swept_clearance,
    vertical_deviation_m,
)
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


def asked(four):
    return MotionProblem({"psm": ArmMotion(ARM, four, LIMITS)}, range_slack=SLACK)


def timed_ms(work, repeats=REPEATS):
    """Return the times of repeated work in ms."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - begin))
    return np.array(times)


def told(times_ms):
    return f"least {times_ms.min():.2f} ms, p50 {np.median(times_ms):.2f} ms, p95 {np.percentile(times_ms, 95):.2f} ms"


def bench_planner(name, problems, samples):
    """Print what one planner makes of the recorded transfers."""
    plan_motion(problems[0], name)
    whole, alone = [], []
    for problem in problems:
        whole.append([plan_motion(problem, name).compute_ms for _ in range(REPEATS)])
        alone.append(timed_ms(lambda problem=problem: PLANNERS[name](problem)))
    plans = [plan_motion(problem, name) for problem in problems]
    use = [plan.use["psm"] for plan in plans]
    off_m = [vertical_deviation_m(a.arms["psm"], plan.paths["psm"]) for a, plan in zip(problems, plans, strict=True)]
    print(f"planner '{name}': {sum(plan.found for plan in plans)} of {len(plans)} found")
    lengths = np.array([round(100 * plan.duration_s) for plan in plans])
    print(f"  recorded length minus planned, samples of 10 ms: {(samples - lengths).tolist()}")
    duration_s, bound_s = (np.mean([getattr(plan, key) for plan in plans]) for key in ("duration_s", "bound_s"))
    print(f"  mean duration {duration_s:.3f} s, bound {bound_s:.3f} s")
    ratios = max(u.velocity_ratio for u in use), max(u.acceleration_ratio for u in use)
    print(f"  largest ratios: velocity {ratios[0]:.6f}, acceleration {ratios[1]:.6f}")
    print(f"  off the vertical: up to {1e3 * max(off_m):.2f} mm")
    print(f"  a plan with its check: {told(np.array(whole))} (target 5 ms)")
    print(f"  the planner alone: {told(np.array(alone))}")


def bench_plain_loop(problems):
    """Print how the spline's search compares with one that is not vectorised."""
    fast = [timed_ms(lambda problem=problem: splines.spline(problem), 5).min() for problem in problems]
    plans = [splines.spline(problem)["psm"] for problem in problems]
    splines.CubicGrid = PlainGrid
    plain = [timed_ms(lambda problem=problem: splines.spline(problem), 1).min() for problem in problems]
    again = [splines.spline(problem)["psm"] for problem in problems]
    splines.CubicGrid = CubicGrid
    same = all(a.trajectory.duration_s == b.trajectory.duration_s for a, b in zip(plans, again, strict=True))
    print(f"plain loop: {np.mean(plain):.0f} ms, {np.mean(plain) / np.mean(fast):.0f} times slower; same: {same}")


def bench_replacement(problems):
    """Print what it takes to go elsewhere from the middle of a motion."""
    times, shares = [], []
    for problem, other in zip(problems, [*problems[1:], problems[0]], strict=True):
        under_way = plan_motion(problem).trajectory
        q, velocity = under_way(0.5 * under_way.duration_s), under_way(0.5 * under_way.duration_s, 1)
        goal = other.arms["psm"].waypoints[1]
        times.append(timed_ms(lambda q=q, v=velocity, goal=goal: move_to(q, v, goal, LIMITS)))
        move = move_to(q, velocity, goal, LIMITS)
        shares.append(max(limit_use(ARM, move, LIMITS).acceleration_ratio, 0.0))
    print(f"a move from under way: {told(np.array(times))}; uses up to {max(shares):.6f} of the acceleration")


def base(x_m, lean_rad):
    return SE3.from_parts(SO3.axis("y", lean_rad), [x_m, 0.0, 0.15])


def two_arms(left, right):
    """Return two PSMs over a table, each on a transfer between two places (x, y)."""
    arms = {}
    for name, T_world_base, (pick, place) in (("psm1", base(-0.08, -0.4), left), ("psm2", base(0.08, 0.4), right)):
        tips_m = [[*pick, 0.0], [*pick, 0.03], [*place, 0.03], [*place, 0.0]]
        four = ik(ARM, T_world_base.inverse() @ SE3.from_parts(SO3.identity(), tips_m))
        asked_of_it = ArmMotion(ARM, four, LIMITS, T_world_base=T_world_base, up=T_world_base.matrix[2, :3])
        trajectory = plan_motion(MotionProblem({name: asked_of_it})).trajectory
        arms[name] = MovingArm(ARM, trajectory, T_world_base)
    return arms


def bench_clearance():
    """Print what it takes to know how near two arms come."""
    cases = {
        "apart": two_arms(((-0.06, 0.0), (-0.03, 0.01)), ((0.03, 0.01), (0.06, 0.0))),
        "one after the other": two_arms(((-0.04, 0.0), (0.01, 0.0)), ((-0.02, 0.0), (0.03, 0.0))),
        "meeting": two_arms(((-0.04, 0.01), (0.02, 0.01)), ((0.03, 0.0), (-0.02, 0.0))),
    }
    for name, arms in cases.items():
        seconds = max(arm.end_s for arm in arms.values())
        for words, kept in (("is 1 mm kept", {"enough_m": 1e-3}), ("to 10 um", {"resolution_m": 1e-5})):
            clear = swept_clearance(arms, **kept)
            times = timed_ms(lambda arms=arms, kept=kept: swept_clearance(arms, **kept), 100)
            between = f"{1e3 * clear.distance_m:.3f} to {1e3 * clear.sampled_m:.3f} mm"
            print(f"two arms {name}, {seconds:.2f} s, {words}: {between}; {told(times)} (target 3 ms)")


def main():
    data = Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))
    with np.load(data / "dvrk/motion/reference_waypoints.npz") as recorded:
        waypoints, samples = recorded["waypoints"], recorded["cubic_samples"]
    problems = [asked(four) for four in waypoints]
    for name in PLANNERS:
        bench_planner(name, problems, samples)
    bench_plain_loop(problems[:2])
    bench_replacement(problems)
    bench_clearance()


if __name__ == "__main__":
    main()
