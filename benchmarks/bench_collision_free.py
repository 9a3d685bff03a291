"""Collision-free planning of both Raven arms at once by 'convex': times, problems solved, and plans that collide.

Run: .venv/bin/python benchmarks/bench_collision_free.py; with --random N it plans N random problems instead of those of
collision_free.npz, which --freeze makes anew. Every plan is checked at finer samples than the planner's. Times are
processor times of plan and check together, on one core.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from trocar.arms import capsules, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.lab import load_station
from trocar.motion import ArmMotion, Facing, HalfSpace, MotionProblem, plan_motion
from trocar.motion.convex.scene import Scene
from trocar.motion.convex.search import Search

STATION = load_station("raven-pair")
ARMS = tuple(STATION.arms)
TABLE_M = -0.162
TABLE = HalfSpace([0.0, 0.0, TABLE_M], [0.0, 0.0, 1.0])
CAMERA_M = np.array([-0.0511, 0.1386, 0.0665])  # where it was when the problems were frozen
FACING = Facing([0.0, 1.0, 0.0], CAMERA_M, np.radians(80))
TIP_M_S = 0.01
KEPT_M = 1e-3
PLACES_M = np.array([[-0.15, -0.05, -0.157], [0.0, 0.05, -0.09]])
HARD_M = (-0.008, -0.003)
EASY, HARD = 200, 100
FROZEN = Path(__file__).parent / "collision_free.npz"
FINE = 401


def pose(rng):
    """Return a random pose in the shared workspace: within 35 degrees of straight down, marks to the camera."""
    tip_m = rng.uniform(*PLACES_M)
    tilt, azimuth = np.radians(rng.uniform(0, 35)), rng.uniform(0, 2 * np.pi)
    aside = CAMERA_M - tip_m
    turn = np.arctan2(aside[1], aside[0]) - np.pi / 2 + rng.uniform(-0.5, 0.5)
    lean = SO3.exp(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
    return SE3.from_parts(lean @ SO3.axis("z", turn), tip_m)


def joints(rng, arm, jaw_rad):
    """Return random joints of an arm that clear the table and show its marks, or None."""
    T_world_tip = pose(rng)
    try:
        q = ik(arm.model, arm.T_world_base.inverse() @ T_world_tip)
    except OutOfReach:
        return None
    solids = capsules(arm.model, q, jaw_rad).moved(arm.T_world_base)
    low_m = (solids.ends_m[..., 2].min(axis=-1) - solids.radii_m).min()
    seen = FACING.angle_rad(T_world_tip) < FACING.max_rad
    return q if seen and low_m > TABLE_M + KEPT_M else None


def apart_m(both, jaws):
    """Return the distance of the two arms at joints (2, 6)."""
    first, second = (
        capsules(arm.model, q, jaw).moved(arm.T_world_base)
        for arm, q, jaw in zip(STATION.arms.values(), both, jaws, strict=True)
    )
    return capsule_distances_m(first, second).min()


def both_arms(rng, jaws):
    """Return random joints (2, 6) at which the two arms keep their distance."""
    while True:
        both = [joints(rng, arm, jaw) for arm, jaw in zip(STATION.arms.values(), jaws, strict=True)]
        if all(q is not None for q in both) and apart_m(both, jaws) > KEPT_M:
            return np.array(both)


def random_case(rng):
    """Return waypoints (2 arms, 2, 6) and openings (2,) of a random problem."""
    jaws = rng.uniform(0.0, 1.2, 2)
    return np.stack([both_arms(rng, jaws), both_arms(rng, jaws)], axis=1), jaws


def asked(waypoints, jaws):
    """Return the problem."""
    arms = {
        name: ArmMotion(
            arm.model,
            points,
            arm.limits,
            T_world_base=arm.T_world_base,
            jaw_rad=float(jaw),
            max_tip_m_s=TIP_M_S,
            facing=FACING,
        )
        for (name, arm), points, jaw in zip(STATION.arms.items(), waypoints, jaws, strict=True)
    }
    return MotionProblem(arms, obstacles={"table": TABLE}, min_distance_m=KEPT_M)


def sampled_m(problem, motion, count=FINE):
    """Return the least distance along a motion: a function from shares of it to joints (n, 12)."""
    scene = Scene.of(problem)
    return scene.distances(motion(np.linspace(0, 1, count)), np.zeros(count)).distance_m.min()


def straight_m(problem):
    """Return the least distance on the straight line in joint space."""
    start, end = (np.concatenate([arm.waypoints[i] for arm in problem.arms.values()]) for i in (0, -1))
    return sampled_m(problem, lambda share: start + share[:, None] * (end - start), 201)


def planned_m(problem, plan):
    """Return the least distance along a plan, at many samples."""
    seconds = plan.duration_s
    return sampled_m(
        problem, lambda share: np.concatenate([plan.trajectories[n](share * seconds) for n in ARMS], axis=1)
    )


def solved_somehow(problem, tries=60):
    """Return whether the search finds a motion from any of many random starts."""
    rng = np.random.default_rng(0)
    search = Search(problem, Scene.of(problem))
    if search.plain() is not None or search.round_about() is not None:
        return True
    plain, bump = search.starts.plain, np.sin(np.pi * search.curve.places)[:, None]
    size = np.tile([0.3, 0.3, 0.04, 0.5, 0.3, 0.3], len(problem.arms))
    second = np.sin(2 * np.pi * search.curve.places)[:, None]
    for _ in range(tries):
        control = plain + bump * rng.normal(size=plain.shape[1]) * size + second * rng.normal(size=12) * size / 2
        search.scene = search.scene.everything()
        if search.followed(control) is not None:
            return True
    return False


def freeze():
    """Store easy problems, whose straight line is free, and hard ones, whose straight line collides by 3 to 8 mm."""
    rng = np.random.default_rng(7)
    easy, hard, feasible = [], [], []
    while len(easy) < EASY or len(hard) < HARD:
        case = random_case(rng)
        problem = asked(*case)
        least_m = straight_m(problem)
        if least_m > KEPT_M + 1e-4 and len(easy) < EASY:
            easy.append(case)
        elif HARD_M[0] <= least_m <= HARD_M[1] and len(hard) < HARD:
            hard.append(case)
            feasible.append(solved_somehow(problem))
    parts = {"easy": easy, "hard": hard}
    arrays = {name: np.stack([case[0] for case in cases]) for name, cases in parts.items()}
    arrays |= {f"{name}_jaws": np.stack([case[1] for case in cases]) for name, cases in parts.items()}
    np.savez_compressed(FROZEN, feasible=np.array(feasible), **arrays)


def timed(cases):
    """Return plans and their processor times in ms, the lesser of two."""
    plans, times = [], []
    for case in cases:
        problem, least = asked(*case), np.inf
        for _ in range(2):
            begin = time.process_time()
            plan = plan_motion(problem, "convex")
            least = min(least, 1e3 * (time.process_time() - begin))
        plans.append(plan)
        times.append(least)
    return plans, np.array(times)


def bench_frozen():
    """Print results and times of the frozen problems."""
    with np.load(FROZEN) as file:
        data = dict(file)
    for name in ("easy", "hard"):
        cases = list(zip(data[name], data[f"{name}_jaws"], strict=True))
        plan_motion(asked(*cases[0]), "convex")
        plans, times = timed(cases)
        found = np.array([plan.found for plan in plans])
        collides = sum(planned_m(asked(*c), p) < KEPT_M - 2e-5 for c, p in zip(cases, plans, strict=True) if p.found)
        mean_s = np.mean([plan.duration_s for plan in plans if plan.found])
        told = f"median {np.median(times):.1f} ms, p90 {np.percentile(times, 90):.1f} ms, most {times.max():.1f} ms"
        print(f"{name}: {len(cases)} problems, {found.sum()} solved; {told}; {mean_s:.1f} s long; {collides} collide")
        if name == "hard":
            can = data["feasible"]
            print(f"hard: {(found & can).sum()} of the {can.sum()} that an exhaustive multi-start solves")


def bench_random(count, seed):
    """Print results and times of random problems."""
    rng = np.random.default_rng(seed)
    tally, collides, times, least = {"found": 0, "infeasible": 0, "not found": 0, "refused": 0}, 0, [], np.inf
    for _ in range(count):
        problem = asked(*random_case(rng))
        begin = time.process_time()
        plan = plan_motion(problem, "convex")
        times.append(1e3 * (time.process_time() - begin))
        kind = "found" if plan.found else next((k for k in ("infeasible", "not found") if k in plan.reason), "refused")
        tally[kind] += 1
        if plan.found:
            near_m = planned_m(problem, plan)
            least = min(least, near_m)
            collides += near_m < KEPT_M - 2e-5
        elif kind == "refused":
            print(plan.reason)
    told = ", ".join(f"{number} {name}" for name, number in tally.items())
    print(f"random: {count} problems: {told}; {collides} answers collide; least distance {1e3 * least:.4f} mm")
    print(f"random: median {np.median(times):.1f} ms, p90 {np.percentile(times, 90):.1f} ms, most {max(times):.1f} ms")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--freeze", action="store_true", help="make the stored problems anew")
    parser.add_argument("--random", type=int, default=0, help="plan so many random problems instead")
    parser.add_argument("--seed", type=int, default=0, help="of the random problems")
    given = parser.parse_args()
    if given.freeze:
        freeze()
    if not given.random:
        bench_frozen()
    else:
        bench_random(given.random, given.seed)


if __name__ == "__main__":
    main()
