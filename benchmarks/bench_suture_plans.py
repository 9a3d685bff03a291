"""Plans of sutures in random setups against trying all plans, with margins and manipulability computed anew.

Margin, manipulability of both arms, limits and heights above the tissue come from the arm's frames and Jacobian, sample
by sample, and the best even plan and the best one with bounded gaps from all plans on a coarse grid.

Run: .venv/bin/python benchmarks/bench_suture_plans.py [SETUPS] [SEED]
"""

from __future__ import annotations

import itertools
import sys

import numpy as np
from bench_suture_setups import random_setup
from numpy.typing import NDArray

from trocar.arms import frames, jacobian, wrist_depth_m
from trocar.errors import InvalidInput
from trocar.geometry import TURN
from trocar.tasks.suture.planning import DexterityMap, Spacing, SutureSetup, dexterity, plan_even, plan_gaps
from trocar.tasks.suture.planning import suture_joints as joints_of
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import path_samples
from trocar.tasks.suture.planning.setup import mirrored

POSITIONS, COUNT, WEIGHT = 24, 4, 0.75
GAPS = (4, 8)
"""Bounds of the gaps, in steps of the grid: 60 to 120 deg."""
TOLERANCE = 1e-9


def looked_at(setup: SutureSetup) -> tuple[NDArray, NDArray, NDArray]:
    """Return margin, mean of det(J J^T) and feasibility (2, n) of the sutures of one arm, by definition."""
    thetas = np.arange(POSITIONS) * (TURN / POSITIONS)
    arm, q = setup.arm, joints_of(setup, thetas).q
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
    return np.where(real, margin, -1e3), squared, real & within & deep & (height >= -TOLERANCE)


def dexterities(setup: SutureSetup) -> tuple[NDArray, NDArray]:
    """Return dexterity and feasibility (2, n) by the default reward, computed by definition."""
    margin, squared, can = looked_at(setup)
    _, others, they_can = looked_at(mirrored(setup))
    of_arm = []
    for values, driven in ((squared, can), (others, they_can)):
        counted = np.where(driven.any(0), driven, True)
        of_arm.append((values * counted).sum(0) / counted.sum(0))
    given = np.mean(of_arm, 0)
    better = np.where(can[0] == can[1], margin[0] >= margin[1], can[0])
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
    worst, off, done, feasible, sunk = 0.0, 0.0, 0, 0, 0
    while done < setups:
        try:
            setup = random_setup(rng)
        except InvalidInput:  # a grasp beyond the needle's tail
            continue
        map = dexterity(setup, positions=POSITIONS)
        values, can = dexterities(setup)
        if (map.joints.feasible != can).any():
            raise SystemExit(f"setup {done}: feasible in {map.joints.feasible.sum()}, by definition in {can.sum()}")
        worst = max(worst, float(np.abs(map.values - values)[can].max(initial=0.0)))
        off = max(off, agrees(map, values, can))
        feasible += bool(can.any(0).all())
        sunk += bool((map.joints.above_tissue_m < 0).any())
        done += 1
    print(f"{setups} random setups, {feasible} feasible all round, {sunk} with some suture's instrument in the tissue")
    print(f"dexterities differ by at most {worst:.1g}, plans from the best of all by at most {off:.1g}")
    if not max(worst, off) < TOLERANCE:
        raise SystemExit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
