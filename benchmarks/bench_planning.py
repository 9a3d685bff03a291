"""Planning: every planner on recorded transfers, Algorithm 2 beside a plain loop, starts in motion, distances of arms.

Run: .venv/bin/python benchmarks/bench_planning.py; the recordings: TROCAR_DATA, or shared/data beside
the repository. The row of TOPPRA needs `pip install trocar[bench]`.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar.arms import ARMS, MOTION_LIMITS, fk, ik
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
from trocar.motion.splines import CubicGrid
from trocar.motion.straight_line import StraightLine

ARM, LIMITS = ARMS["psm-classic"], MOTION_LIMITS["paper"]
SLACK = 0.02  # recorded waypoints lie up to 0.3 mm beyond the nominal insertion
REPEATS = 20
UPRIGHT = (True, False, True)


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


def asked(four, **more):
    """Return the problem of a transfer; ``arm`` holds options of the arm's motion, such as its straight pieces."""
    return MotionProblem({"psm": ArmMotion(ARM, four, LIMITS, **more.pop("arm", {}))}, range_slack=SLACK, **more)


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


@dataclass(frozen=True)
class Row:
    """A planner's results on recorded transfers: durations, use of limits, deviation from vertical, times of plans."""

    name: str
    durations_s: list
    velocity: float
    acceleration: float
    off_m: float
    plan_ms: list
    refused: int = 0

    def told(self):
        """Return the row as text."""
        ms = f"{np.median(self.plan_ms):8.1f}" if self.plan_ms else 8 * " "
        return (
            f"{self.name:28s} {np.mean(self.durations_s):8.4f} {self.velocity:9.6f} {self.acceleration:12.9f} "
            f"{1e3 * self.off_m:10.4f} {ms}" + f"  {self.refused} refused" * bool(self.refused)
        )


def cpu_ms(work, repeats):
    """Return the processor time of one piece of work, the least of several, in ms."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return min(times)


def planned(name, problems, title=None):
    """Return a planner's row and its plans."""
    plan_motion(problems[0], name)
    repeats = 2 if name == "sqp" else 5
    times = [cpu_ms(lambda problem=problem: PLANNERS[name](problem), repeats) for problem in problems]
    plans = [plan_motion(problem, name) for problem in problems]
    use = [plan.use["psm"] for plan in plans]
    off_m = [vertical_deviation_m(a.arms["psm"], plan.paths["psm"]) for a, plan in zip(problems, plans, strict=True)]
    ratios = max(u.velocity_ratio for u in use), max(u.acceleration_ratio for u in use)
    refused = sum(not plan.found for plan in plans)
    return Row(title or name, [plan.duration_s for plan in plans], *ratios, max(off_m), times, refused), plans


def toppra_row(waypoints):
    """Return the row of TOPPRA along straight lines between the waypoints, where it stops; None if not installed."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError:
        return None
    toppra.setup_logging("ERROR")
    bounds = [np.stack([-most, most], axis=1) for most in map(np.asarray, (LIMITS.velocity, LIMITS.acceleration))]
    limits = [
        constraint.JointVelocityConstraint(bounds[0]),
        constraint.JointAccelerationConstraint(bounds[1], constraint.DiscretizationType.Interpolation),
    ]

    def along(line):
        path = toppra.SplineInterpolator(np.linspace(0, 1, len(line.q)), line.q)
        grid = np.linspace(0, 1, 101)
        return algorithm.TOPPRA(
            limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel"
        ).compute_trajectory()

    durations_s, ratios, off_m, times = [], [], [], []
    for four in waypoints:
        work = lambda four=four: [along(line) for line in StraightLine.between(ARM, four[:-1], four[1:], LIMITS)]  # noqa: E731
        times.append(cpu_ms(work, 2))
        moves = work()
        durations_s.append(sum(move.duration for move in moves))
        for index, move in enumerate(moves):
            t = np.arange(0, move.duration, 1e-3)
            ratios.append(
                [np.abs(move(t, k) / most).max() for k, most in ((1, LIMITS.velocity), (2, LIMITS.acceleration))]
            )
            if index != 1:
                tips = fk(ARM, move(t)).translation_m
                off_m.append(np.linalg.norm((tips - tips[0])[:, :2], axis=1).max())
    return Row("toppra, stops at the corners", durations_s, *np.max(ratios, axis=0), max(off_m), times)


def bench_planners(waypoints, recorded):
    """Print the results of each planner on recorded transfers, and the bound that no motion beats."""
    upright = {"straight": UPRIGHT}
    rows, plans = [], {}
    for name, title, more in (
        ("spline", None, {}),
        ("sqp", None, {"arm": upright}),
        ("optimal", None, {"arm": upright}),
    ):
        row, plans[name] = planned(name, [asked(four, **dict(more)) for four in waypoints], title)
        rows.append(row)
    stops = toppra_row(waypoints)
    rows.insert(2, stops) if stops else print("TOPPRA is not installed: `pip install trocar[bench]` gives its row.")
    print(f"{len(waypoints)} recorded transfers")
    print(f"{'planner':28s} {'mean s':>8s} {'velocity':>9s} {'acceleration':>12s} {'off mm':>10s} {'cpu ms':>8s}")
    for row in rows:
        print(row.told())
    bound = np.mean([plan.bound_s for plan in plans["optimal"]])
    print(f"{'bound of these waypoints':28s} {bound:8.4f}")
    optimal = np.mean([plan.duration_s for plan in plans["optimal"]])
    print(f"optimal is {100 * (optimal / bound - 1):.1f} % above its bound")
    for name, key in (("spline", "cubic_samples"), ("sqp", "qp_samples")):
        lengths = np.array([100 * plan.duration_s for plan in plans[name]])
        print(f"{name}: recorded length minus planned, samples of 10 ms: {(recorded[key] - lengths).round(1).tolist()}")
    whole = [plan.compute_ms for _ in range(REPEATS) for plan in [plan_motion(asked(waypoints[0]), "optimal")]]
    print(f"a plan by 'optimal' with its check: {told(np.array(whole))}")


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
    """Print the time to plan a new motion from the middle of another one."""
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
    """Print the time to compute how near two arms come."""
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
    with np.load(data / "dvrk/motion/reference_waypoints.npz") as file:
        recorded = dict(file)
    waypoints = recorded["waypoints"]
    problems = [asked(four) for four in waypoints]
    bench_planners(waypoints, recorded)
    bench_plain_loop(problems[:2])
    bench_replacement(problems)
    bench_clearance()


if __name__ == "__main__":
    main()
