"""The general problem on the grid: any number of sutures, bounded gaps, forbidden arcs, fixed positions, tension.

A plan is a closed walk round the circle whose steps are the gaps. Its worst suture counts, so that this is a bottleneck
problem: the best plan uses only positions of some least rank, and which rank is found by bisection, each time
asking whether the positions that rank at least so high let a walk close. All starts are asked at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.sutures.plan import TURN, Spacing, SuturePlan, check_count, plan_on_grid, ranks
from trocar.sutures.rewards import DexterityMap

ON_GRID = 1e-9
"""A fixed position may miss the grid by this share of a step, a gap's bound by as much: rounding."""


@dataclass(frozen=True, eq=False)
class Walks:
    """Closed walks round a circle of positions.

    Attributes:
        positions: on the circle.
        steps: in a walk.
        least: step, in positions.
        most: step, in positions.
        through: positions that a walk must stand on, ascending.
    """

    positions: int
    steps: int
    least: int
    most: int
    through: tuple[int, ...] = ()

    def within(self, least: float, most: float) -> Walks:
        """Return those walks whose steps lie strictly between these."""
        inner, outer = math.floor(least + ON_GRID) + 1, math.ceil(most - ON_GRID) - 1
        return replace(self, least=max(self.least, inner), most=min(self.most, outer))

    def starts(self, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return positions (s,) on one of which every closed walk stands.

        That is the first fixed position, or else the allowed ones on any arc of the longest step: the arc with fewest.
        """
        if self.through:
            return np.array(self.through[:1])
        width = min(self.most, self.positions)
        held = np.concatenate([[0], np.cumsum(np.concatenate([allowed, allowed[: width - 1]]))])
        arc = np.argmin(held[width:] - held[:-width]) + np.arange(width)
        arc %= self.positions
        return np.sort(arc[allowed[arc]])

    def closing(self, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return those of the ``starts`` (c,) from which a walk over allowed positions closes."""
        starts = self.starts(allowed)
        if not len(starts) or not self.steps * self.least <= self.positions <= self.steps * self.most:
            return starts[:0]
        n, p = self.steps, self.positions
        ahead = self._ahead(allowed, starts)
        first, past = self.sources()
        before = np.zeros((len(starts), p + 2), dtype=np.int32)  # how many are reached before each position
        before[:, 1:] = 1
        for k in range(1, n + 1):  # after k steps a walk that will close is between these
            low, high = max(k * self.least, p - (n - k) * self.most), min(k * self.most, p - (n - k) * self.least) + 1
            reached = ahead[:, low:high] & (before[:, past[low:high]] > before[:, first[low:high]])
            before[:, : low + 1] = 0
            np.cumsum(reached, axis=1, out=before[:, low + 1 : high + 1])
            before[:, high + 1 :] = before[:, high, None]
        return starts[before[:, p + 1] > before[:, p]]

    def _ahead(self, around: NDArray, starts: NDArray[np.intp]) -> NDArray:
        """Return what there is round the circle (p,) from each start on to itself again (s, p + 1)."""
        twice = np.concatenate([around, around, around[:1]])
        return np.lib.stride_tricks.sliding_window_view(twice, self.positions + 1)[starts]

    def sources(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return from where one step leads to each position (p + 1,) after the start: the first, and one past the last.

        No step leads across a position that a walk must stand on.
        """
        here = np.arange(self.positions + 1)
        first, past = np.maximum(here - self.most, 0), np.maximum(here - self.least + 1, 0)
        if self.through:
            stops = np.array(self.through) - self.through[0]
            first = np.maximum(first, stops[np.maximum(np.searchsorted(stops, here) - 1, 0)])
        return first, np.maximum(first, past)

    def best_sum(self, allowed: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the closed walk (steps,) over allowed positions with the largest sum of values.

        There must be one. Of several, the one from the first start, with the shortest last steps.
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
    """Return the largest of rows ``first[i]`` to ``past[i]`` (not included) of values (m, s), for each i; (i, s).

    Any window is covered by two whose length is a power of two; minus infinity where it is empty.
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
    """Return the best plan on the map's grid. Proven, not sampled: no other is worth more.

    What is maximised, each time less the cost of tension:

    - with a reward that puts feasibility first, if any plan is feasible: the worst dexterity, over feasible plans;
    - with such a reward, if none is: the worst dexterity among the infeasible sutures alone, which are what is in the
      way; the plan's ``bound`` is of these sutures;
    - with other rewards: the worst dexterity, over all plans, feasible or not.

    Without tension this is exact to the last bit, and of plans whose worst sutures are alike, the one with the largest
    sum of dexterities is taken. With tension, ever more even gaps are asked for, as long as they could make up for what
    they cost in dexterity. Positions on the ends of forbidden arcs are allowed; fixed positions must lie on the grid.

    Raises:
        TrocarError: no plan can meet the spacing; says which numbers are in the way.
    """
    walks = walks_on_grid(map, count, spacing)
    every = ranks(map)
    choice, rank = np.argmax(every, axis=0), every.max(0)
    rank[~spacing.allows(map.thetas_rad)] = -1
    best = tried = _best(map, walks, rank, choice, spacing.tension)
    if best is None:
        raise TrocarError(no_way(count, spacing, f"on the grid of {len(rank)} positions"))
    if best.feasible and map.reward.feasible_first:
        rank[~map.joints.feasible.any(0)] = -1
    while tried and tried.bound + tried.tension_cost > best.bound:  # one more even could still be worth more
        even = len(rank) / count
        walks = walks.within(even * (1 - tried.uneven), even * (1 + tried.uneven))
        tried = _best(map, walks, rank, choice, spacing.tension)
        if tried and tried.bound >= best.bound:
            best = tried
    return best


def _best(
    map: DexterityMap, walks: Walks, rank: NDArray[np.intp], choice: NDArray[np.intp], tension: float
) -> SuturePlan | None:
    """Return the plan with the best worst suture; tension counts in its worth, but not in its choice."""
    level = highest_closing(walks, rank)
    if level < 0:
        return None
    worth = np.take_along_axis(map.values, choice[None], 0)[0]
    where = walks.best_sum(rank >= level, worth)
    even = len(rank) / len(where)
    uneven = np.abs(np.diff(where, append=where[0] + len(rank)) - even).max() / even
    return plan_on_grid(map, where, choice[where], tension * float(uneven))


def walks_on_grid(map: DexterityMap, count: int, spacing: Spacing) -> Walks:
    """Return the closed walks that the spacing asks for, but for the forbidden arcs, or raise a sentence."""
    check_closes(count, spacing)
    positions = len(map.thetas_rad)
    step = TURN / positions
    least = max(1, math.ceil(spacing.least_gap_rad / step - ON_GRID))
    most = math.floor(spacing.most_gap_rad / step + ON_GRID)
    if not count * least <= positions <= count * most:
        raise TrocarError(
            f"{count} sutures with gaps of {least} to {most} of the grid's {positions} steps cannot close the circle; "
            "give more positions, wider bounds, or plan in the continuum"
        )
    through = np.rint(np.array(spacing.fixed_rad) / step)
    for angle, miss in zip(spacing.fixed_rad, np.abs(through * step - spacing.fixed_rad), strict=True):
        if miss > ON_GRID * step:
            raise TrocarError(
                f"the fixed position {math.degrees(angle):g} deg is not on the grid of {positions} positions, every "
                f"{math.degrees(step):g} deg; give a multiple of it, other positions, or plan in the continuum"
            )
    return Walks(positions, count, least, most, tuple(sorted({int(k) % positions for k in through})))


def check_closes(count: int, spacing: Spacing) -> None:
    """Raise a sentence if the gaps cannot add up to a turn, or the fixed positions contradict the rest."""
    check_count(count)
    least, most = math.degrees(spacing.least_gap_rad), math.degrees(spacing.most_gap_rad)
    if not count * least <= 360 * (1 + 1e-9) or not count * most >= 360 * (1 - 1e-9):
        raise TrocarError(
            f"{count} gaps of {least:g} to {most:g} deg add up to {count * least:g} to {count * most:g} deg, not to "
            f"360; give a least gap of at most {360 / count:g} and a largest of at least that, or another number of "
            "sutures"
        )
    if len(spacing.fixed_rad) > count:
        raise TrocarError(
            f"{len(spacing.fixed_rad)} positions are fixed, but only {count} sutures planned; give as many sutures"
        )
    for angle, allowed in zip(spacing.fixed_rad, spacing.allows(spacing.fixed_rad), strict=True):
        if not allowed:
            raise TrocarError(
                f"the fixed position {math.degrees(angle):g} deg lies in a forbidden arc; move the one or the other"
            )


def no_way(count: int, spacing: Spacing, where: str) -> str:
    """Return the sentence for a spacing that no plan meets, though its gaps could close."""
    arcs = ", ".join(f"{math.degrees(a):g} to {math.degrees(b):g}" for a, b in spacing.forbidden_rad) or "none"
    fixed = ", ".join(f"{math.degrees(angle):g}" for angle in spacing.fixed_rad) or "none"
    return (
        f"no {count} sutures {where} have gaps of {math.degrees(spacing.least_gap_rad):g} to "
        f"{math.degrees(spacing.most_gap_rad):g} deg, stand outside the forbidden arcs ({arcs} deg) and on the fixed "
        f"positions ({fixed} deg); widen the gaps' bounds, shorten an arc or free a position"
    )


def highest_closing(walks: Walks, rank: NDArray[np.intp]) -> int:
    """Return the highest rank such that a walk over positions of at least that rank closes; -1 if there is none."""
    levels = np.unique(rank[rank >= 0])
    low, high = -1, len(levels)  # level ``low`` closes, if there is one; level ``high`` does not
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if len(walks.closing(rank >= levels[middle])) else (low, middle)
    return int(levels[low]) if low >= 0 else -1
