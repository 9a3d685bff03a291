"""Plans of sutures in random setups against a search of all plans, with margins and manipulability recomputed.

Margins, manipulability of both arms, limits, and distances from tissue, body wall and second arm are recomputed from
the arm's frames and Jacobian, sample by sample. The best even plan and the best plan with bounded gaps are found by
trying all plans on a coarse grid. Two thirds of the setups have a body wall, two thirds a second arm.

Run: .venv/bin/python benchmarks/bench_suture_plans.py [SETUPS] [SEED]
"""

from __future__ import annotations

import itertools
import math
import sys
from dataclasses import replace

import numpy as np
from bench_suture_setups import random_setup
from numpy.typing import NDArray

from trocar.arms import fk, frames, jacobian, wrist_depth_m
from trocar.arms.solids import DRIVE_M
from trocar.errors import InvalidInput
from trocar.geometry import TURN
from trocar.tasks.suture.planning import (
    DIRECTIONS,
    DexterityMap,
    Spacing,
    Suture,
    SutureSetup,
    dexterity,
    plan_even,
    plan_gaps,
)
from trocar.tasks.suture.planning import suture_joints as joints_of
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD, OFF_WALL_M
from trocar.tasks.suture.planning.primitive import grasp_pose, path_samples
from trocar.tasks.suture.planning.setup import Puller, Wall, mirrored

POSITIONS, COUNT, WEIGHT = 24, 4, 0.75
GAPS = (4, 8)
"""Bounds of the gaps, in steps of the grid: 60 to 120 deg."""
TOLERANCE = 1e-9


def surrounded(setup: SutureSetup, rng: np.random.Generator) -> SutureSetup:
    """Return the setup with a body wall about its port, a second arm, both or neither."""
    x, y, up = setup.T_world_base.translation_m.tolist()
    slope, rises, thick = (float(rng.uniform(0.0, most)) for most in (0.8, TURN, 0.1))
    rise = math.tan(slope) * (x * math.cos(rises) + y * math.sin(rises))
    up = max(0.01, up - rise - float(rng.uniform(-0.05, 1.05)) * thick / math.cos(slope))
    turned, aside, second_up = (
        float(rng.uniform(0.0, TURN)),
        float(rng.uniform(0.03, 0.15)),
        float(rng.uniform(0.08, 0.15)),
    )
    walled, paired = rng.uniform(size=2) < 2 / 3
    return replace(
        setup,
        wall=Wall(up, thick, slope, rises) if walled else Wall(),
        puller=Puller(turned, aside, second_up) if paired else Puller(),
    )


def in_the_way(setup: SutureSetup, q: NDArray) -> tuple[NDArray, NDArray]:
    """Return whether sutures (2, n) with these joints meet the body wall, and whether they meet the second arm."""
    wall, puller, arm, shape = setup.wall, setup.puller, setup.arm, setup.arm.instrument
    T = setup.T_world_base @ frames(arm, q)
    port, pitch, yaw = setup.T_world_base.translation_m, T.translation_m[..., 5, :], T.translation_m[..., 6, :]
    fingers = yaw + shape.finger_length_m * T.matrix[..., 6, :3, 1]
    back = (port - pitch) / np.linalg.norm(port - pitch, axis=-1, keepdims=True)
    drive = pitch + shape.shaft_length_m * back
    second = np.array(
        [
            puller.sideways_m * math.cos(puller.azimuth_rad),
            puller.sideways_m * math.sin(puller.azimuth_rad),
            puller.up_m,
        ]
    )
    meets_wall = meets_arm = np.zeros(q.shape[:2], dtype=bool)
    if wall.up_m:
        leans = -math.sin(wall.slope_rad)
        normal = [leans * math.cos(wall.azimuth_rad), leans * math.sin(wall.azimuth_rad), math.cos(wall.slope_rad)]

        def over(points: NDArray) -> NDArray:
            return (points - [0.0, 0.0, wall.up_m]) @ normal

        needle = setup.T_world_base @ fk(arm, q) @ grasp_pose(setup).inverse()
        across = needle.matrix[..., :3, 2]
        lies = np.linalg.norm(normal - (across @ normal)[..., None] * across, axis=-1)
        wide = shape.finger_radius_m + shape.finger_length_m * math.sin(JAW_OPEN_RAD / 2)
        inside = [
            over(pitch) + max(shape.shaft_radius_m, shape.wrist_radius_m),
            over(yaw) + shape.knuckle_radius_m,
            over(fingers) + wide,
            over(needle.translation_m) + (setup.needle.radius_m + setup.needle.wire_m / 2) * lies,
        ]
        out = over(drive) - math.hypot(DRIVE_M[0], DRIVE_M[1]) / 2 - wall.thick_m
        ports = [over(port), *([over(second)] if puller.up_m else [])]
        meets_wall = (np.max(inside, axis=0) > TOLERANCE - OFF_WALL_M).any(2) | (out < OFF_WALL_M - TOLERANCE).any(2)
        meets_wall |= min(ports) < -TOLERANCE or max(ports) > wall.thick_m + TOLERANCE
    if puller.up_m:
        ends = [(pitch + shape.shaft_radius_m * back, drive), (pitch, yaw), (yaw, fingers)]
        radii = (shape.shaft_radius_m, shape.wrist_radius_m, shape.finger_radius_m)
        last = (np.array([setup.insertion.straight_m]), np.array([setup.insertion.turn_rad]))
        meets_arm = meets_arm.copy()
        for row, n in np.ndindex(q.shape[:2]):
            suture = Suture(setup, n * TURN / POSITIONS, DIRECTIONS[row])
            tip = setup.circle.T_world_circle.apply(suture.needle_tip_m(*last)[0])
            apart = min(
                between(second, tip, a[row, n, -1], b[row, n, -1]) - radius
                for (a, b), radius in zip(ends, radii, strict=True)
            )
            meets_arm[row, n] = apart - shape.shaft_radius_m < APART_M - TOLERANCE
    return meets_wall, meets_arm


def between(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> float:
    """Return the distance of segments ab and cd: of an end from the other, or of the lines if that lies within both."""

    def from_segment(p: NDArray, q: NDArray, r: NDArray) -> float:
        share = np.clip((p - q) @ (r - q) / ((r - q) @ (r - q)), 0.0, 1.0)
        return float(np.linalg.norm(p - q - share * (r - q)))

    found = [from_segment(a, c, d), from_segment(b, c, d), from_segment(c, a, b), from_segment(d, a, b)]
    shares, *_ = np.linalg.lstsq(np.column_stack([b - a, c - d]), c - a, rcond=None)
    if (shares >= 0).all() and (shares <= 1).all():
        found.append(float(np.linalg.norm(a + shares[0] * (b - a) - c - shares[1] * (d - c))))
    return min(found)


def looked_at(setup: SutureSetup) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return one arm's margin, mean det(J J^T), whether it can drive, and feasibility (2, n), by definition."""
    thetas = np.arange(POSITIONS) * (TURN / POSITIONS)
    joints = joints_of(setup, thetas)
    arm, q = setup.arm, joints.q
    real = np.isfinite(q).all((2, 3))
    q = np.where(real[..., None, None], q, 0.0)
    middle, half = (arm.lower + arm.upper) / 2, (arm.upper - arm.lower) / 2
    margin = (1 - np.abs(q - middle) / half)[..., 3:].min((2, 3))
    J = jacobian(arm, q)
    squared = np.linalg.det(J @ J.swapaxes(-1, -2)).mean(2)
    T = setup.T_base_circle.inverse() @ frames(arm, q)
    shape, at = arm.instrument, T.translation_m[..., 2]
    along, closing, axis = shape.finger_m(1).T
    turning = np.flatnonzero(path_samples(setup).jaws_rad != 0.0)  # there the jaws may be open
    lowest = np.minimum(
        at[..., 5] - max(shape.shaft_radius_m, shape.wrist_radius_m), at[..., 6] - shape.knuckle_radius_m
    )
    for side, opening in itertools.product((-1, 1), (0.0, 0.5 * JAW_OPEN_RAD)):
        turned = q.copy()
        turned[:, :, turning, 5] -= side * opening
        finger = (setup.T_base_circle.inverse() @ frames(arm, turned)).matrix[..., 6, 2, :]
        corners = np.stack([side * np.abs(closing), along, axis, np.ones_like(axis)])
        lowest = np.minimum(lowest, (finger @ corners).min(-1))
    height = lowest.min(-1)
    within = ((q >= arm.lower - TOLERANCE) & (q <= arm.upper + TOLERANCE)).all((2, 3))
    deep = wrist_depth_m(arm, q).min(2) >= arm.safe_depth_m - TOLERANCE
    meets_wall, meets_arm = in_the_way(setup, q)
    found = joints.inside_wall_m < -TOLERANCE, joints.arms_apart_m < -TOLERANCE
    reaches = real & (wrist_depth_m(arm, q) > 1e-3).all(2)
    if ((found[0] != meets_wall) | (found[1] != meets_arm))[reaches].any():
        raise SystemExit(f"{setup}: body wall or second arm in the way of others than by definition")
    driven = real & within & deep & (height >= -TOLERANCE) & ~meets_wall
    return np.where(real, margin, -1e3), squared, driven, driven & ~meets_arm


def dexterities(setup: SutureSetup) -> tuple[NDArray, NDArray]:
    """Return dexterity and feasibility (2, n) by the default reward, computed by definition."""
    margin, squared, drives, can = looked_at(setup)
    _, others, they_drive, _ = looked_at(mirrored(setup))
    of_arm = []
    for values, driven in ((squared, drives), (others, they_drive)):
        counted = np.where(driven.any(0), driven, True)
        of_arm.append((values * counted).sum(0) / counted.sum(0))
    given = np.mean(of_arm, 0)
    better = np.where(drives[0] == drives[1], margin[0] >= margin[1], drives[0])
    chosen = np.where(better, margin[0], margin[1])
    unit = chosen.max() if chosen.max() > 0 else 1.0
    return WEIGHT * margin / unit + (1 - WEIGHT) * given / given.max(), can


def best_of_all(values: NDArray, can: NDArray, low: int, high: int) -> tuple[bool, float]:
    """Return (feasible, reward) of the best of all plans whose gaps are within these bounds, in any directions."""
    best = (False, -np.inf)
    keys = [[(bool(can[row, k]), float(values[row, k])) for row in (0, 1)] for k in range(POSITIONS)]
    of_place = [max(both) for both in keys]
    for where in itertools.combinations(range(POSITIONS), COUNT):
        gaps = np.diff(where, append=where[0] + POSITIONS).tolist()
        if low <= min(gaps) and max(gaps) <= high:
            best = max(best, min(of_place[k] for k in where))
    return best


def agrees(map: DexterityMap, values: NDArray, can: NDArray) -> float:
    """Return by how much the planners' plans differ from the best of all plans; infinite if one is not feasible."""
    spacing = Spacing(GAPS[0] * TURN / POSITIONS, GAPS[1] * TURN / POSITIONS)
    even = POSITIONS // COUNT
    plans = ((plan_even(map, COUNT), (even, even)), (plan_gaps(map, COUNT, spacing), GAPS))
    off = [0.0]
    for plan, bounds in plans:
        feasible, reward = best_of_all(values, can, *bounds)
        off.append(abs(plan.bound - reward) if plan.feasible == feasible else np.inf)
    return max(off)


def main(setups: int = 500, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    worst, off, done, feasible, met = 0.0, 0.0, 0, 0, np.zeros(3, dtype=int)
    while done < setups:
        try:
            setup = surrounded(random_setup(rng), rng)
        except InvalidInput:  # a grasp beyond the needle's tail
            continue
        map = dexterity(setup, positions=POSITIONS)
        values, can = dexterities(setup)
        if (map.joints.feasible != can).any():
            raise SystemExit(f"setup {done}: feasible in {map.joints.feasible.sum()}, by definition in {can.sum()}")
        worst = max(worst, float(np.abs(map.values - values)[can].max(initial=0.0)))
        off = max(off, agrees(map, values, can))
        feasible += bool(can.any(0).all())
        clear_m = (map.joints.above_tissue_m, map.joints.inside_wall_m, map.joints.arms_apart_m)
        met += [bool((distance < 0).any() and (distance > 0).any()) for distance in clear_m]
        done += 1
    print(f"{setups} random setups, {feasible} feasible all round")
    counts = ", ".join(str(count) for count in met)
    print(f"tissue, body wall, second arm in the way of some sutures, not of all: {counts}")
    print(f"dexterities differ by at most {worst:.1g}, plans from the best of all by at most {off:.1g}")
    if not max(worst, off) < TOLERANCE:
        raise SystemExit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
