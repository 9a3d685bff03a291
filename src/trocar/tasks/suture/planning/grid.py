"""The best plans on a grid: evenly spaced sutures (the paper's problem), or bounded gaps, arcs, fixed places, tension.

A plan is a closed walk round the circle whose steps are the gaps. Its worst suture counts, so this is a bottleneck
problem, solved by dynamic programming over the steps, from all starts at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

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

    @property
    def starts(self) -> NDArray[np.intp]:
        """Return positions (s,) of which every closed walk visits at least one.

        These are the first fixed position or, without one, an arc that no step passes over.
        """
        return np.array(self.through[:1]) if self.through else np.arange(min(self.max_step, self.positions))

    @property
    def _stops(self) -> list[int]:
        """Return the positions, ahead of the start, that no step passes over, with the start at both ends."""
        return [0, *(k - self.through[0] for k in self.through[1:]), self.positions]

    def layers(self, around: NDArray, starts: NDArray[np.intp], add: np.ufunc) -> list[NDArray[np.float64]]:
        """Return what the best walks from these starts have gathered (s, p + 1) after no, one, ... all steps.

        Args:
            around: value of each position (p,), minus infinity where no walk may go.
            starts: (s,) positions; columns are the places ahead of them, the last is the start again.
            add: adds a place to a walk: ``np.add`` for sums, ``np.minimum`` for the worst place.
        """
        from scipy.ndimage import maximum_filter1d  # slow to import

        gain = around[(starts[:, None] + np.arange(self.positions + 1)) % self.positions].astype(np.float64)
        found = [np.full(gain.shape, -np.inf)]
        found[0][:, 0] = gain[:, 0]
        for _ in range(self.steps):
            best = np.full(gain.shape, -np.inf)
            for stop, following in pairwise(self._stops):
                first = stop + self.min_step
                width = min(self.max_step, following - stop) - self.min_step + 1
                if width > 0:  # a window of this width, up to one shortest step before each place
                    sources = found[-1][:, stop : following + 1 - self.min_step]
                    best[:, first : following + 1] = maximum_filter1d(
                        sources, width, axis=1, mode="constant", cval=-np.inf, origin=(width - 1) // 2
                    )
            found.append(add(best, gain))
        return found

    def best(self, rank: NDArray[np.intp], values: NDArray[np.float64]) -> NDArray[np.intp] | None:
        """Return the closed walk (steps,) whose lowest rank is highest; None if none closes.

        Of several, it is the one with the largest sum of values; ties go to the first start, then to the shortest last
        steps.

        Args:
            rank: of each position (p,); no walk goes where it is negative.
            values: of each position (p,).
        """
        starts = self.starts
        lowest = self.layers(np.where(rank >= 0, rank, -np.inf), starts, np.minimum)[-1][:, -1]
        level = lowest.max()
        if level < 0:
            return None
        starts = starts[lowest == level]
        sums = self.layers(np.where(rank >= level, values, -np.inf), starts, np.add)
        start, place, walk = int(np.argmax(sums[-1][:, -1])), self.positions, []
        for layer in reversed(sums[:-1]):
            first = max(place - self.max_step, *(stop for stop in self._stops if stop < place))
            came_from = np.arange(place - self.min_step, first - 1, -1)
            place = int(came_from[np.argmax(layer[start, came_from])])
            walk.append((starts[start] + place) % self.positions)
        return np.sort(np.array(walk))


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
    where = walks.best(rank, np.take_along_axis(map.values, choice[None], 0)[0])
    if where is None:
        return None
    even = len(rank) / len(where)
    uneven = np.abs(np.diff(where, append=where[0] + len(rank)) - even).max() / even
    return plan_on_grid(map, where, choice[where], tension * float(uneven))


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
