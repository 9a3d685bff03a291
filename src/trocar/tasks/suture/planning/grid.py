"""The best plans on a grid: evenly spaced sutures (the paper's problem), or bounded gaps, arcs, fixed places, tension.

A plan is a closed walk round the circle whose steps are the gaps. Its worst suture counts, so this is a bottleneck
problem: the best plan uses only positions of some minimum rank. Bisection finds this rank: each time it asks whether a
walk over the positions of at least a given rank closes. All starts are tested at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import TURN, shown
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan, check_count, plan_on_grid, ranks
from trocar.tasks.suture.planning.rewards import DexterityMap

ON_GRID = 1e-9
"""A fixed position, or the bound of a gap, may miss the grid by this share of a step: rounding."""


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
    check_count(count)
    positions = len(map.thetas_rad)
    if positions % count:
        raise InvalidInput(
            f"{positions} positions",
            f"cannot be divided evenly among {count} sutures",
            f"give a multiple, such as {count * -(-positions // count)} positions",
        )
    starts = positions // count
    all_ranks = ranks(map)
    choice = np.argmax(all_ranks, axis=0)
    worst = all_ranks.max(0).reshape(count, starts).min(0)
    where = int(np.argmax(worst)) + starts * np.arange(count)
    return plan_on_grid(map, where, choice[where])


@dataclass(frozen=True, eq=False)
class Walks:
    """Closed walks round a circle of positions.

    Attributes:
        positions: number of positions on the circle.
        steps: number of steps in a walk.
        min_step: shortest step, in positions.
        max_step: longest step, in positions.
        through: positions that a walk must visit, ascending.
    """

    positions: int
    steps: int
    min_step: int
    max_step: int
    through: tuple[int, ...] = ()

    def within(self, longer_than: float, shorter_than: float) -> Walks:
        """Return the walks whose steps are also strictly longer and shorter than these numbers of positions."""
        inner, outer = math.floor(longer_than + ON_GRID) + 1, math.ceil(shorter_than - ON_GRID) - 1
        return replace(self, min_step=max(self.min_step, inner), max_step=min(self.max_step, outer))

    def starts(self, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return positions (s,) of which every closed walk visits at least one.

        These are the first fixed position or, without one, the allowed positions on any arc as long as the longest
        step, which no walk can jump over: the arc with the fewest of them.
        """
        if self.through:
            return np.array(self.through[:1])
        width = min(self.max_step, self.positions)
        held = np.concatenate([[0], np.cumsum(np.concatenate([allowed, allowed[: width - 1]]))])
        arc = np.argmin(held[width:] - held[:-width]) + np.arange(width)
        arc %= self.positions
        return np.sort(arc[allowed[arc]])

    def closing(self, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the ``starts`` (c,) from which a walk over allowed positions closes."""
        starts = self.starts(allowed)
        if not len(starts) or not self.steps * self.min_step <= self.positions <= self.steps * self.max_step:
            return starts[:0]
        n, p = self.steps, self.positions
        ahead = self._ahead(allowed, starts)
        first, past = self.sources()
        # ``before`` counts the reached positions before each position: a difference of two counts tells whether any
        # position of a range is reached, however long the range.
        before = np.zeros((len(starts), p + 2), dtype=np.int32)
        before[:, 1:] = 1
        for k in range(1, n + 1):
            # after k steps a walk that can still close lies between these positions
            low = max(k * self.min_step, p - (n - k) * self.max_step)
            high = min(k * self.max_step, p - (n - k) * self.min_step) + 1
            reached = ahead[:, low:high] & (before[:, past[low:high]] > before[:, first[low:high]])
            before[:, : low + 1] = 0
            np.cumsum(reached, axis=1, out=before[:, low + 1 : high + 1])
            before[:, high + 1 :] = before[:, high, None]
        return starts[before[:, p + 1] > before[:, p]]

    def _ahead(self, around: NDArray, starts: NDArray[np.intp]) -> NDArray:
        """Return values round the circle (p,) as seen from each start, up to the start again (s, p + 1)."""
        twice = np.concatenate([around, around, around[:1]])
        return np.lib.stride_tricks.sliding_window_view(twice, self.positions + 1)[starts]

    def sources(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the range from which one step leads to each position (p + 1,) after the start: first, one past last.

        No step passes over a position that a walk must visit.
        """
        here = np.arange(self.positions + 1)
        first, past = np.maximum(here - self.max_step, 0), np.maximum(here - self.min_step + 1, 0)
        if self.through:
            stops = np.array(self.through) - self.through[0]
            first = np.maximum(first, stops[np.maximum(np.searchsorted(stops, here) - 1, 0)])
        return first, np.maximum(first, past)

    def best_sum(self, allowed: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the closed walk (steps,) over allowed positions with the largest sum of values.

        Found by dynamic programming over the steps; at least one walk must close. Ties go to the first start, then to
        the shortest last steps.
        """
        starts = self.closing(allowed)
        gain = self._ahead(np.where(allowed, values, -np.inf), starts).T
        first, past = self.sources()
        sums = [np.full(gain.shape, -np.inf)]
        sums[0][0] = gain[0]
        for _ in range(self.steps):
            sums.append(largest_in(sums[-1], first, past) + gain)
        start = int(np.argmax(sums[-1][-1]))
        place, walk = self.positions, []
        for layer in reversed(sums[:-1]):
            came_from = np.arange(past[place] - 1, first[place] - 1, -1)
            place = int(came_from[np.argmax(layer[came_from, start])])
            walk.append((starts[start] + place) % self.positions)
        return np.sort(np.array(walk))


def largest_in(values: NDArray[np.float64], first: NDArray[np.intp], past: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the maximum over rows ``first[i]`` to ``past[i]`` (exclusive) of values (m, s), for each i; (i, s).

    A sparse table: any window is covered by two windows whose length is a power of two, so that no window is scanned.
    The maximum of an empty window is minus infinity.
    """
    length = np.maximum(past - first, 1)
    power = np.log2(length).astype(np.intp)
    table = [values]
    for half in 2 ** np.arange(power.max()):
        longer = table[-1].copy()
        np.maximum(longer[:-half], table[-1][half:], out=longer[:-half])
        table.append(longer)
    every = np.stack(table)
    found = np.maximum(every[power, first], every[power, np.maximum(past - 2**power, 0)])
    found[past <= first] = -np.inf
    return found


def plan_gaps(map: DexterityMap, count: int, spacing: Spacing) -> SuturePlan:
    """Return the best plan on the map's grid: a proven optimum, not a sampled one.

    The objective, each time minus the cost of tension, is:

    - if the reward puts feasibility first and any plan is feasible: the worst dexterity, over feasible plans;
    - if the reward does and no plan is feasible: the worst dexterity of the infeasible sutures alone, since these stand
      in the way; the plan's ``bound`` refers to these sutures;
    - with other rewards: the worst dexterity, over all plans, feasible or not.

    Without tension the result is exact to the last bit, and of plans with equal worst sutures the one with the largest
    sum of dexterities is returned. With tension, plans with more and more even gaps are tried, as long as their lower
    tension cost could make up for the dexterity that they lose. Positions on the ends of forbidden arcs are allowed;
    fixed positions must lie on the grid.

    Args:
        map: dexterity of the sutures on the grid.
        count: number of sutures.
        spacing: constraints on their positions, and the cost of uneven gaps.

    Raises:
        InvalidInput: no plan can meet the spacing; names the numbers that prevent it.

    Example:
        >>> from math import radians
        >>> from trocar.tasks.suture.planning import PRESETS, Spacing, dexterity, plan_gaps
        >>> plan = plan_gaps(dexterity(PRESETS["default"].setup), 4, Spacing(radians(75), radians(105)))
        >>> round(plan.reward, 3), plan.feasible
        (0.656, True)
    """
    check_spacing(count, spacing)
    walks = walks_on_grid(len(map.thetas_rad), count, spacing)
    every = ranks(map)
    choice, rank = np.argmax(every, axis=0), every.max(0)
    rank[~spacing.allows(map.thetas_rad)] = -1
    best = tried = _best(map, walks, rank, choice, spacing.tension)
    if best is None:
        raise _no_way(count, spacing, len(rank))
    if best.feasible and map.reward.feasible_first:
        rank[~map.joints.feasible.any(0)] = -1
    # ``bound + tension_cost`` is the worst dexterity of the plan just tried. More even plans can only lose dexterity:
    # once it is below the best value, not even saving the whole tension cost makes up for that.
    while tried and tried.bound + tried.tension_cost > best.bound:
        even = len(rank) / count
        walks = walks.within(even * (1 - tried.unevenness), even * (1 + tried.unevenness))
        tried = _best(map, walks, rank, choice, spacing.tension)
        if tried and tried.bound >= best.bound:
            best = tried
    return best


def _best(
    map: DexterityMap, walks: Walks, rank: NDArray[np.intp], choice: NDArray[np.intp], tension: float
) -> SuturePlan | None:
    """Return the plan with the best worst suture; tension is charged to its value, but does not affect the choice."""
    level = highest_closing(walks, rank)
    if level < 0:
        return None
    values = np.take_along_axis(map.values, choice[None], 0)[0]
    where = walks.best_sum(rank >= level, values)
    even = len(rank) / len(where)
    uneven = np.abs(np.diff(where, append=where[0] + len(rank)) - even).max() / even
    return plan_on_grid(map, where, choice[where], tension * float(uneven))


def highest_closing(walks: Walks, rank: NDArray[np.intp]) -> int:
    """Return the highest rank such that a walk over the positions of at least that rank closes; -1 if none does."""
    levels = np.unique(rank[rank >= 0])
    low, high = -1, len(levels)  # level ``low`` closes, if there is one; level ``high`` does not
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if len(walks.closing(rank >= levels[middle])) else (low, middle)
    return int(levels[low]) if low >= 0 else -1


def walks_on_grid(positions: int, count: int, spacing: Spacing) -> Walks:
    """Return the closed walks that meet the spacing apart from its forbidden arcs, or raise InvalidInput."""
    step = TURN / positions
    min_step = max(1, math.ceil(spacing.min_gap_rad / step - ON_GRID))
    max_step = math.floor(spacing.max_gap_rad / step + ON_GRID)
    if not count * min_step <= positions <= count * max_step:
        raise InvalidInput(
            f"{count} sutures with gaps of {min_step} to {max_step} of the grid's {positions} steps",
            "cannot close the circle",
            "give more positions or wider bounds",
        )
    through = np.rint(np.array(spacing.fixed_rad) / step)
    for angle, miss in zip(spacing.fixed_rad, np.abs(through * step - spacing.fixed_rad), strict=True):
        if miss > ON_GRID * step:
            raise InvalidInput(
                f"the fixed position {shown(angle, 'rad', 'g')}",
                f"is not on the grid of {positions} positions, every {shown(step, 'rad', 'g')}",
                "give a multiple of it, or another number of positions",
            )
    return Walks(positions, count, min_step, max_step, tuple(sorted({int(k) % positions for k in through})))


def check_spacing(count: int, spacing: Spacing) -> None:
    """Raise InvalidInput if the gaps cannot add up to a turn, or the fixed positions contradict the rest."""
    check_count(count)
    min_deg, max_deg = math.degrees(spacing.min_gap_rad), math.degrees(spacing.max_gap_rad)
    if not count * min_deg <= 360 * (1 + 1e-9) or not count * max_deg >= 360 * (1 - 1e-9):
        raise InvalidInput(
            f"{count} gaps of {min_deg:g} to {max_deg:g} deg",
            f"add up to {count * min_deg:g} to {count * max_deg:g} deg, not to 360",
            f"give a smallest gap of at most {360 / count:g} deg and a largest gap of at least that, or another number "
            "of sutures",
        )
    if len(spacing.fixed_rad) > count:
        raise InvalidInput(
            f"{len(spacing.fixed_rad)} positions", f"are fixed, but only {count} sutures are planned", "plan more"
        )
    for angle, allowed in zip(spacing.fixed_rad, spacing.allows(spacing.fixed_rad), strict=True):
        if not allowed:
            raise InvalidInput(
                f"the fixed position {shown(angle, 'rad', 'g')}", "lies in a forbidden arc", "move one of the two"
            )


def _no_way(count: int, spacing: Spacing, positions: int) -> InvalidInput:
    """Return the error for a spacing that no plan meets, although its gaps could add up to a turn."""
    arcs = ", ".join(f"{math.degrees(a):g} to {math.degrees(b):g}" for a, b in spacing.forbidden_rad) or "none"
    fixed = ", ".join(f"{math.degrees(angle):g}" for angle in spacing.fixed_rad) or "none"
    return InvalidInput(
        f"no {count} sutures on the grid of {positions} positions",
        f"have gaps of {shown(spacing.min_gap_rad, 'rad', 'g')} to {shown(spacing.max_gap_rad, 'rad', 'g')}, lie "
        f"outside the forbidden arcs ({arcs} deg) and cover the fixed positions ({fixed} deg)",
        "widen the gaps' bounds, shorten an arc or free a position",
    )
