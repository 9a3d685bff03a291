"""Times of suture planners, for the paper's problem and the general one, compared with plain Python loops; bounds.

Run: .venv/bin/python benchmarks/bench_sutures.py
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from trocar.arms.inverse import closed_form
from trocar.geometry import TURN
from trocar.tasks.suture.planning import (
    PRESETS,
    DexterityMap,
    Preset,
    Spacing,
    dexterity,
    plan_continuous,
    plan_even,
    plan_exhaustive,
    plan_gaps,
)
from trocar.tasks.suture.planning.joints import tip_harmonics
from trocar.tasks.suture.planning.primitive import places

POSITIONS, COUNT, REPEATS = 360, 4, 40
TARGET_PAPER_MS, TARGET_MORE_MS = 10.0, 20.0
PROBLEMS = ((4, 75, 105), (4, 60, 120), (6, 40, 80), (8, 30, 60), (12, 20, 40), (12, 15, 60))  # sutures, gaps in deg
PLAIN_PROBLEMS = ((4, 60, 120), (12, 20, 40))


class FloatMath:
    """The functions that the closed form needs, for floats."""

    copysign, sqrt, root, atan2, atan2_right = math.copysign, math.sqrt, math.sqrt, math.atan2, math.atan2


def timed(work: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Return median and minimum time in ms, and the last result."""
    times, result = [], None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times)), min(times), result


def plain_joints(preset: Preset, theta: float, row: int, parts: Any, middle: list[float]) -> list[list[float]]:
    """Return the joints at all places of one suture, with the roll in the winding nearest to its middle."""
    constants, c, s = preset.setup.arm.solver_constants, math.cos(theta), math.sin(theta)
    suture, last = [], None
    for constant, cosine, sine in zip(parts[0][row], parts[1][row], parts[2][row], strict=True):
        pose = [[constant[i][j] + c * cosine[i][j] + s * sine[i][j] for j in range(4)] for i in range(4)]
        q = closed_form(pose, FloatMath, constants)[:6]
        q[0] += TURN * round((middle[0] - q[0]) / TURN)
        if last is not None:
            q[3] += TURN * round((last - q[3]) / TURN)
        last = q[3]
        suture.append(q)
    rolls = [q[3] for q in suture]
    back = TURN * round(((max(rolls) + min(rolls)) / 2 - middle[3]) / TURN)
    for q in suture:
        q[3] -= back
    return suture


def plain_margin(name: str, limit: list[float], largest: list[float]) -> float:
    """Return the margin by one of two formulas."""
    if name == "smallest":
        return min(1 - angle / bound for angle, bound in zip(largest, limit, strict=True))
    return sum(math.degrees(max(bound - angle, 0.0)) ** 2 for angle, bound in zip(largest, limit, strict=True))


def plain_manipulability(arm: Any, q: list[float]) -> float:
    """Return |J J^T| in its closed form."""
    depth = -arm.wrist_sign * (q[2] + arm.offsets[2])
    s1, s2 = math.sin(arm.twists_rad[1]), math.sin(arm.twists_rad[2])
    wrist = depth * (depth * math.cos(q[4] + arm.offsets[4]) + arm.wrist_length_m)
    return (s1 * s2 * math.sin(q[1] + arm.offsets[1]) * wrist) ** 2


def plain_map(preset: Preset) -> tuple[list[list[float]], list[int], list[bool]]:
    """Return dexterities both ways, better directions, and whether these are feasible, by loops over floats."""
    arm, reward, along = preset.setup.arm, preset.reward, places(preset.setup)
    parts, middle = tip_harmonics(preset.setup, along).tolist(), arm.middle_floats
    looked_at = [k for k, station in enumerate(along.station) if station or reward.at == "path"]
    limit = [(high - low) / 2 for low, high in arm.ranges[3:]]
    margins, feasible, given = [[], []], [[], []], []
    for number in range(POSITIONS):
        total, theta = 0.0, number * (TURN / POSITIONS)
        for row in (0, 1):
            suture = plain_joints(preset, theta, row, parts, middle)
            largest = [max(abs(suture[k][i] - middle[i]) for k in looked_at) for i in (3, 4, 5)]
            margins[row].append(plain_margin(reward.margin, limit, largest))
            total += sum(plain_manipulability(arm, q) for q in suture)
            inside = all(
                low - 1e-9 <= value <= high + 1e-9
                for q in suture
                for value, (low, high) in zip(q, arm.ranges, strict=True)
            )
            deep = all(-arm.wrist_sign * (q[2] + arm.offsets[2]) >= arm.safe_depth_m - 1e-9 for q in suture)
            feasible[row].append(inside and deep)
        given.append(total / (2 * len(along.station)))
    choice = []
    for one, other, one_ok, other_ok in zip(*margins, *feasible, strict=True):
        first = (one_ok, one) >= (other_ok, other) if reward.feasible_first else one >= other
        choice.append(0 if first else 1)
    q_unit, m_unit = max(margins[row][k] for k, row in enumerate(choice)), max(given)
    values = [
        [reward.weight * q / q_unit + (1 - reward.weight) * m / m_unit for q, m in zip(line, given, strict=True)]
        for line in margins
    ]
    return values, choice, [feasible[row][k] for k, row in enumerate(choice)]


def plain_even(values: list[list[float]], choice: list[int]) -> tuple[int, float]:
    """Return start and reward of the best evenly spaced plan."""
    starts = POSITIONS // COUNT
    best = (-1, -math.inf)
    for start in range(starts):
        worst = min(values[choice[k]][k] for k in range(start, POSITIONS, starts))
        if worst > best[1]:
            best = (start, worst)
    return best


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
    """Time the paper's problem, including inverse kinematics; return whether they meet the target, and map."""

    def solve() -> tuple[DexterityMap, Any]:
        found = dexterity(preset.setup, preset.reward, POSITIONS)
        return found, plan_even(found, COUNT)

    solve()
    median, minimum, (found, plan) = timed(solve, REPEATS)
    search, _, _ = timed(lambda: plan_even(found, COUNT), REPEATS)
    every, _, exhaustive = timed(lambda: plan_exhaustive(found, COUNT), REPEATS)
    plain_ms, _, (values, choice, feasible) = timed(lambda: plain_map(preset), 1)
    plain_search, _, (start, reward) = timed(lambda: plain_even(values, choice), 3)
    np.testing.assert_allclose(values, found.values, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(feasible, found.feasible)
    assert start == round(math.degrees(plan.positions_rad[0])) and abs(reward - plan.reward) < 1e-9
    assert (exhaustive.positions_rad == plan.positions_rad).all() and exhaustive.reward == plan.reward
    assert (exhaustive.directions == plan.directions).all()
    plain = plain_ms + plain_search
    print(
        f"  the paper's problem, {POSITIONS} positions, including IK: median {median:.2f} ms, minimum {minimum:.2f} ms"
    )
    print(f"    the search alone {search:.2f} ms; enumeration of all 90 x 2^4 plans {every:.2f} ms, the same plan")
    print(f"    plain Python loop {plain:.0f} ms, {plain / median:.0f} times slower, same dexterities and plan")
    print(f"    start {start} deg, worst suture {plan.reward:.4f}, feasible {plan.feasible}")
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


def certificates(found: DexterityMap) -> None:
    """Print how much plans at any angles can gain over plans on the grid."""
    for count, low, high in ((4, 90, 90), *PROBLEMS):
        grid = plan_gaps(found, count, spacing(low, high)).reward
        for tolerance in (1e-3, 1e-5):
            ms, _, plan = timed(
                lambda n=count, a=low, b=high, t=tolerance: plan_continuous(found, n, spacing(a, b), t), 1
            )
            print(
                f"  {count:2d} sutures, gaps {low} to {high} deg: grid {grid:.5f}, any angles {plan.reward:.5f}, "
                f"proven bound {plan.bound:.5f} (gap {plan.bound - plan.reward:.1e}), {ms:.0f} ms"
            )


def main() -> None:
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    met = True
    for name, preset in PRESETS.items():
        print(f"{name}:")
        paper, found = paper_problem(preset)
        print(" general problem, dexterities given:")
        general = general_problem(found)
        print(" at any angles, proven by intervals:")
        certificates(found)
        met &= paper and general
    words = "met" if met else "MISSED"
    print(
        f"targets {words}: {TARGET_PAPER_MS:.0f} ms for the paper's problem, {TARGET_MORE_MS:.0f} ms more for the "
        "general one"
    )


if __name__ == "__main__":
    main()
