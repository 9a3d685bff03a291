"""Plans at any angles: a local search from the best plan on the grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import TURN
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap

FINEST_RAD = 1e-6
"""The search ends when a step is shorter than this."""
LONGEST_RUN = 12
"""At most so many neighbours move together, or all sutures do."""
SLACK = 1e-9
"""Gaps and fixed positions may be missed by this many rad: rounding."""
CERTIFIED = "refined from the best plan on the grid by a local search; nothing is proven for any angles"


def refined(map: DexterityMap, plan: SuturePlan, spacing: Spacing) -> SuturePlan:
    """Return a plan at any angles that is at least as good as a plan on the map's grid.

    A pattern search: a run of neighbouring sutures moves by a step, either way; the best such move is made or, if none
    is better, the step halved. Neighbours move together because gaps at their bounds couple them. As on the grid, the
    worst suture counts, minus the cost of tension; among infeasible plans, if the reward puts feasibility first, the
    worst infeasible one.

    Args:
        map: setup, reward and scales.
        plan: where to start; it meets the spacing.
        spacing: constraints on the positions, and the cost of uneven gaps.
    """
    thetas = plan.positions_rad
    n = len(thetas)
    runs = _runs(n)
    step = TURN / len(map.thetas_rad) / 2
    while step >= FINEST_RAD:
        shifts = step * np.concatenate([np.zeros((1, n)), runs, -runs])
        here, ahead, behind = np.split(np.arange(3 * n), 3)
        near = map.at(np.concatenate([thetas, thetas + step, thetas - step]))
        which = np.where(shifts > 0, ahead, np.where(shifts < 0, behind, here))
        scores = _scores(near.best[which], near.feasible[which], thetas + shifts, map.reward.feasible_first, spacing)
        best = int(np.argmax(scores))
        if best:
            thetas = thetas + shifts[best]
        else:
            step /= 2
    thetas = np.sort(np.mod(thetas, TURN))
    at = map.at(thetas)
    found = SuturePlan(thetas, at.directions, at.best, bool(at.feasible.all()), math.inf, CERTIFIED)
    return replace(found, tension_cost=spacing.tension * found.unevenness)


def _runs(n: int) -> NDArray[np.float64]:
    """Return which (m, n) of n sutures round the circle move together: 1 for those that do."""
    first = np.eye(n)
    lengths = range(1, min(n - 1, LONGEST_RUN) + 1)
    runs = [sum(np.roll(first, k, axis=1) for k in range(length)) for length in lengths]
    return np.concatenate([*runs, np.ones((1, n))])


def _scores(
    rewards: NDArray[np.float64],
    feasible: NDArray[np.bool_],
    thetas_rad: NDArray[np.float64],
    feasible_first: bool,
    spacing: Spacing,
) -> NDArray[np.float64]:
    """Return the scores (m,) of plans (m, n); minus infinity for those that break the spacing, unless it is the first.

    An infeasible plan scores less than any feasible one, if the reward puts feasibility first.
    """
    n = thetas_rad.shape[1]
    gaps = np.diff(thetas_rad, append=thetas_rad[:, :1] + TURN)
    off = np.abs(np.mod(thetas_rad[..., None] - spacing.fixed_rad + np.pi, TURN) - np.pi).min(1)
    kept = (gaps >= spacing.min_gap_rad - SLACK).all(1) & (gaps <= spacing.max_gap_rad + SLACK).all(1)
    kept &= spacing.allows(thetas_rad).all(1) & (off <= SLACK).all(1)
    kept[0] = True  # where the search stands, whatever rounding did
    worst = rewards.min(1)
    if feasible_first:
        lacking = ~feasible.all(1)
        worst = np.where(lacking, np.where(feasible, np.inf, rewards).min(1) - 1e9, worst)
    unevenness = np.abs(gaps * n / TURN - 1).max(1)
    return np.where(kept, worst - spacing.tension * unevenness, -np.inf)
