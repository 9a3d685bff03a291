"""The paper's problem: sutures evenly spaced, at whole steps of the grid; by a fast search and by full enumeration."""

from __future__ import annotations

import itertools

import numpy as np

from trocar.errors import TrocarError
from trocar.sutures.plan import SuturePlan, check_count, plan_on_grid, ranks
from trocar.sutures.rewards import DexterityMap

MOST_PLANS = 20_000_000


def plan_even(map: DexterityMap, count: int = 4) -> SuturePlan:
    """Return the best plan of evenly spaced sutures; of several, the one with the first start.

    Manipulability does not depend on the direction, so that each suture takes its better direction (paper, III-D1), and
    the starts alone, a ``count``-th of the circle, decide: 90 plans, not 1440.

    Raises:
        TrocarError: the positions of the map cannot be divided by ``count``.
    """
    starts = _starts(map, count)
    every = ranks(map)
    choice = np.argmax(every, axis=0)
    worst = every.max(0).reshape(count, starts).min(0)
    where = int(np.argmax(worst)) + starts * np.arange(count)
    return plan_on_grid(map, where, choice[where])


def plan_exhaustive(map: DexterityMap, count: int = 4) -> SuturePlan:
    """Return the same plan by enumerating every start with every combination of directions (paper, III-H).

    Of plans whose worst sutures are alike the first start is taken, and there the largest sum of ranks, since
    the directions of all but the worst suture do not show in the reward.

    Raises:
        TrocarError: the positions of the map cannot be divided by ``count``, or there are too many plans.
    """
    starts = _starts(map, count)
    if starts * 2**count > MOST_PLANS:
        raise TrocarError(
            f"{starts} starts with directions for {count} sutures make {starts * 2**count} plans; enumerate at most "
            f"{MOST_PLANS}, or use plan_even, which finds the same plan"
        )
    every = ranks(map).reshape(2, count, starts)
    combinations = np.array(list(itertools.product((0, 1), repeat=count)))
    plans = every[combinations, np.arange(count)]  # (combinations, count, starts)
    worst = plans.min(1)
    start = int(np.argmax(worst.max(0)))
    alike = worst[:, start] == worst[:, start].max()
    best = int(np.argmax(np.where(alike, plans[:, :, start].sum(1), -1)))
    return plan_on_grid(map, start + starts * np.arange(count), combinations[best])


def _starts(map: DexterityMap, count: int) -> int:
    """Return how many starts differ."""
    check_count(count)
    positions = len(map.thetas_rad)
    if positions % count:
        raise TrocarError(
            f"{positions} positions cannot be divided evenly among {count} sutures; "
            f"give a multiple, such as {count * -(-positions // count)} positions"
        )
    return positions // count
