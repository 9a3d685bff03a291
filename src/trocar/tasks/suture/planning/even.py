"""The paper's problem: evenly spaced sutures on the grid, by a fast search and by full enumeration."""

from __future__ import annotations

import itertools

import numpy as np

from trocar.errors import InvalidInput
from trocar.tasks.suture.planning.plan import SuturePlan, check_count, plan_on_grid, ranks
from trocar.tasks.suture.planning.rewards import DexterityMap

MAX_PLANS = 20_000_000


def plan_even(map: DexterityMap, count: int = 4) -> SuturePlan:
    """Return the best plan of evenly spaced sutures; ties go to the first start.

    Manipulability does not depend on the direction, so each suture takes its better direction (paper, III-D1), and only
    the start remains to be chosen, from a ``count``-th of the circle: 90 plans, not 1440.

    Args:
        map: dexterity of the sutures on the grid.
        count: number of sutures.

    Raises:
        InvalidInput: the positions of the map cannot be divided by ``count``.

    Example:
        >>> from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
        >>> plan = plan_even(dexterity(PRESETS["default"].setup), count=4)
        >>> plan.positions_rad.shape, round(plan.reward, 3), plan.feasible
        ((4,), 0.605, True)
    """
    starts = _starts(map, count)
    all_ranks = ranks(map)
    choice = np.argmax(all_ranks, axis=0)
    worst = all_ranks.max(0).reshape(count, starts).min(0)
    where = int(np.argmax(worst)) + starts * np.arange(count)
    return plan_on_grid(map, where, choice[where])


def plan_exhaustive(map: DexterityMap, count: int = 4) -> SuturePlan:
    """Return the plan of ``plan_even`` by enumerating all starts and combinations of directions (paper, III-H).

    Ties go to the first start and, there, to the largest sum of ranks, since the reward does not depend on the
    directions of any but the worst suture.

    Args:
        map: dexterity of the sutures on the grid.
        count: number of sutures.

    Raises:
        InvalidInput: the positions of the map cannot be divided by ``count``, or there are too many plans.
    """
    starts = _starts(map, count)
    if starts * 2**count > MAX_PLANS:
        raise InvalidInput(
            f"{starts} starts with directions for {count} sutures",
            f"make {starts * 2**count} plans",
            f"enumerate at most {MAX_PLANS}, or use plan_even, which finds the same plan",
        )
    all_ranks = ranks(map).reshape(2, count, starts)
    combinations = np.array(list(itertools.product((0, 1), repeat=count)))
    plans = all_ranks[combinations, np.arange(count)]  # (combinations, count, starts)
    worst = plans.min(1)
    start = int(np.argmax(worst.max(0)))
    alike = worst[:, start] == worst[:, start].max()
    best = int(np.argmax(np.where(alike, plans[:, :, start].sum(1), -1)))
    return plan_on_grid(map, start + starts * np.arange(count), combinations[best])


def _starts(map: DexterityMap, count: int) -> int:
    """Return the number of different starts."""
    check_count(count)
    positions = len(map.thetas_rad)
    if positions % count:
        raise InvalidInput(
            f"{positions} positions",
            f"cannot be divided evenly among {count} sutures",
            f"give a multiple, such as {count * -(-positions // count)} positions",
        )
    return positions // count
