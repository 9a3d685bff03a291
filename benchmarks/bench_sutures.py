"""Times of suture planners, for the paper's problem, the general one (against plain Python loops) and any angles.

Run: .venv/bin/python benchmarks/bench_sutures.py
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from trocar.tasks.suture.planning import (
    PRESETS,
    DexterityMap,
    Preset,
    Spacing,
    dexterity,
    plan_even,
    plan_gaps,
    refined,
)

POSITIONS, COUNT, REPEATS = 360, 4, 40
TARGET_PAPER_MS, TARGET_MORE_MS = 10.0, 20.0
PROBLEMS = ((4, 75, 105), (4, 60, 120), (6, 40, 80), (8, 30, 60), (12, 20, 40), (12, 15, 60))  # sutures, gaps in deg
PLAIN_PROBLEMS = ((4, 60, 120), (12, 20, 40))


def timed(work: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Return median and minimum time in ms, and the last result."""
    times, result = [], None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times)), min(times), result


def plain_gaps(best: list[float], count: int, min_gap: int, max_gap: int) -> float:
    """Return the reward of the best plan with bounded gaps, by bisection and sets of reachable positions."""

    def closes(level: float) -> bool:
        allowed = [value >= level for value in best]
        for start in range(max_gap):
            reached = {start} if allowed[start] else set()
            for _ in range(count):
                reached = {
                    place + gap
                    for place in reached
                    for gap in range(min_gap, max_gap + 1)
                    if place + gap <= start + POSITIONS and allowed[(place + gap) % POSITIONS]
                }
            if start + POSITIONS in reached:
                return True
        return False

    levels = sorted(set(best))
    low, high = 0, len(levels)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if closes(levels[middle]) else (low, middle)
    return levels[low]


def spacing(min_deg: float, max_deg: float) -> Spacing:
    return Spacing(math.radians(min_deg), math.radians(max_deg))


def paper_problem(preset: Preset) -> tuple[bool, DexterityMap]:
    """Time the paper's problem, including inverse kinematics; return whether it meets the target, and the map."""

    def solve() -> tuple[DexterityMap, Any]:
        found = dexterity(preset.setup, preset.reward, POSITIONS)
        return found, plan_even(found, COUNT)

    solve()
    median, minimum, (found, plan) = timed(solve, REPEATS)
    search, _, _ = timed(lambda: plan_even(found, COUNT), REPEATS)
    print(
        f"  the paper's problem, {POSITIONS} positions, including IK: median {median:.2f} ms, minimum {minimum:.2f} ms"
    )
    print(f"    the search alone {search:.2f} ms; worst suture {plan.reward:.4f}")
    return median <= TARGET_PAPER_MS, found


def general_problem(found: DexterityMap) -> bool:
    """Print times for the general problem with several numbers of sutures; return whether all meet the target."""
    met = True
    for count, low, high in PROBLEMS:
        median, minimum, plan = timed(lambda n=count, a=low, b=high: plan_gaps(found, n, spacing(a, b)), REPEATS // 4)
        met &= median <= TARGET_MORE_MS
        line = f"  {count:2d} sutures, gaps {low} to {high} deg: {median:5.2f} ms, minimum {minimum:5.2f} ms; "
        line += f"worst suture {plan.reward:.4f}"
        if (count, low, high) in PLAIN_PROBLEMS and found.feasible.all():
            plain, _, reward = timed(lambda n=count, a=low, b=high: plain_gaps(found.best.tolist(), n, a, b), 1)
            assert reward == plan.reward
            line += f"; plain loop {plain:.0f} ms, {plain / median:.0f} times slower, same reward"
        print(line)
    return met


def any_angles(found: DexterityMap) -> None:
    """Print how much plans at any angles gain over plans on the grid."""
    for count, low, high in ((4, 90, 90), *PROBLEMS):
        grid = plan_gaps(found, count, spacing(low, high))
        ms, _, plan = timed(lambda n=grid, a=low, b=high: refined(found, n, spacing(a, b)), 1)
        print(
            f"  {count:2d} sutures, gaps {low} to {high} deg: grid {grid.reward:.5f}, any angles {plan.reward:.5f}, "
            f"{ms:.0f} ms"
        )


def main() -> None:
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    met = True
    for name, preset in PRESETS.items():
        print(f"{name}:")
        paper, found = paper_problem(preset)
        if preset.setup.insertion.theta_is == "entry":  # gaps in the tissue cannot be bounded then
            middle = replace(preset.setup, insertion=replace(preset.setup.insertion, theta_is="middle"))
            found = dexterity(middle, preset.reward, POSITIONS)
        print(" general problem, dexterities given:")
        general = general_problem(found)
        print(" at any angles, by a local search:")
        any_angles(found)
        met &= paper and general
    words = "met" if met else "MISSED"
    print(
        f"targets {words}: {TARGET_PAPER_MS:.0f} ms for the paper's problem, {TARGET_MORE_MS:.0f} ms more for the "
        "general one"
    )


if __name__ == "__main__":
    main()
