"""The best plans: on a grid, evenly spaced (the paper's problem) or within bounds, and at any angles.

A plan is a closed walk round the circle whose steps are the gaps. Its worst suture counts, so on a grid this is a
bottleneck problem, solved by dynamic programming over the steps, from all starts at once. At any angles, a local search
begins at the best plan of the grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput
from trocar.geometry import TURN, shown
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan, check_count
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTIONS

ON_GRID = 1e-9
"""A fixed position, or the bound of a gap, may miss the grid by this share of a step, because of rounding."""
FINER, MOST_POSITIONS = 5, 2000
"""The search at any angles begins on a grid this many times finer, but with at most this many positions."""
FINEST_RAD = 1e-6
"""The search at any angles ends when a step is shorter than this."""
LONGEST_RUN = 12
"""The search at any angles moves up to this many neighbours together, or all sutures."""
SLACK = 1e-9
"""The search at any angles may miss gaps and fixed positions by this many rad, because of rounding."""
UNPROVEN = "refined from the best plan on the grid by a local search; nothing is proven for any angles"


def plan_even(map: DexterityMap, count: int = 4) -> SuturePlan:
    """Return the best plan of evenly spaced sutures; ties go to the first start.

    Manipulability does not depend on the direction, so each suture takes its better direction (paper, III-D1), and only
    the start remains to be chosen, from a ``count``-th of the circle: 90 plans, not 1440.

    Raises:
        InvalidInput: the positions of the map cannot be divided by ``count``.

    Example:
        >>> from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
        >>> plan = plan_even(dexterity(PRESETS["default"].setup), count=4)
        >>> plan.positions_rad.shape, round(plan.reward, 3), plan.feasible
        ((4,), 0.619, True)
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

    @property
    def starts(self) -> NDArray[np.intp]:
        """Return positions (s,) of which each walk visits one: the first fixed one, or an arc that no step skips."""
        return np.array(self.through[:1]) if self.through else np.arange(min(self.max_step, self.positions))

    @property
    def _stops(self) -> list[int]:
        """Return the positions, counted from the start, that no step may skip, with the start at both ends."""
        return [0, *(k - self.through[0] for k in self.through[1:]), self.positions]

    def layers(self, around: NDArray, starts: NDArray[np.intp], add: np.ufunc) -> list[NDArray[np.float64]]:
        """Return the values (s, p + 1) of the best walks from each start to each place, after 0, 1, ... all steps.

        Args:
            around: value of each position (p,), minus infinity where no walk may go.
            starts: (s,) positions; columns are the places counted from them, the last is the start again.
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
                if width > 0:  # the best over a window of this width that ends one shortest step before each place
                    sources = found[-1][:, stop : following + 1 - self.min_step]
                    best[:, first : following + 1] = maximum_filter1d(
                        sources, width, axis=1, mode="constant", cval=-np.inf, origin=(width - 1) // 2
                    )
            found.append(add(best, gain))
        return found

    def best(self, rank: NDArray[np.intp], values: NDArray[np.float64]) -> NDArray[np.intp] | None:
        """Return the closed walk (steps,) whose lowest rank is highest; None if none closes.

        Ranks and values are those of the positions (p,); no walk goes where the rank is negative. Of several walks, it
        is the one with the largest sum of values; ties go to the first start, then to the shortest last steps.
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

    The objective is:

    - if the reward puts feasibility first and any plan is feasible: the worst dexterity, over feasible plans;
    - if the reward does and no plan is feasible: the worst dexterity of the infeasible sutures alone, since these stand
      in the way; the plan's ``bound`` refers to these sutures;
    - with other rewards: the worst dexterity, over all plans, feasible or not.

    It is exact to the last bit, and of plans with equal worst sutures the one with the largest sum of dexterities is
    returned. Positions on the ends of forbidden arcs are allowed; fixed positions must lie on the grid.

    Raises:
        InvalidInput: no plan can meet the spacing; the message names the numbers that prevent it. Or the setup's
            positions are those of the entries: half a bite from where the sutures hold, so that bounds are useless.

    Example:
        >>> from math import radians
        >>> from trocar.tasks.suture.planning import PRESETS, Spacing, dexterity, plan_gaps
        >>> plan = plan_gaps(dexterity(PRESETS["default"].setup), 4, Spacing(radians(75), radians(105)))
        >>> round(plan.reward, 3), plan.feasible
        (0.656, True)
    """
    spacing.check(count)
    if map.setup.insertion.theta_is == "entry":
        raise InvalidInput(
            "the positions of this setup",
            "are where needles enter, half a bite away from where the sutures hold",
            "for gaps, forbidden arcs and fixed positions let theta_is be middle",
        )
    walks = walks_on_grid(len(map.thetas_rad), count, spacing)
    every = ranks(map)
    choice, rank = np.argmax(every, axis=0), every.max(0)
    rank[~spacing.allows(map.thetas_rad)] = -1
    where = walks.best(rank, np.take_along_axis(map.values, choice[None], 0)[0])
    if where is None:
        raise _no_way(count, spacing, len(rank))
    return replace(plan_on_grid(map, where, choice[where]), spacing=spacing)


def walks_on_grid(positions: int, count: int, spacing: Spacing) -> Walks:
    """Return the closed walks that meet the spacing, apart from its forbidden arcs, or raise InvalidInput."""
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


def ranks(map: DexterityMap) -> NDArray[np.intp]:
    """Return the ranks (2, n) of all sutures, 0 the worst: by feasibility if the reward puts it first, then dexterity.

    Ties in dexterity, as with lambda = 0, are decided by the joint margin. The plan whose worst suture ranks highest is
    the lexicographic optimum: any feasible plan beats any other, then the worst suture counts.
    """
    first = map.joints.feasible if map.reward.feasible_first else np.zeros(map.values.shape, dtype=bool)
    keys = np.stack([map.margin.ravel(), map.values.ravel(), first.ravel()])
    order = np.lexsort(keys)
    found = np.zeros(order.size, dtype=np.intp)
    found[order[1:]] = np.cumsum((np.diff(keys[:, order]) != 0).any(0))
    return found.reshape(map.values.shape)


def plan_on_grid(map: DexterityMap, where: NDArray[np.intp], choice: NDArray[np.intp]) -> SuturePlan:
    """Return the map's best plan with its bound, given indices (n,) of its positions and rows (n,) of directions."""
    order = np.argsort(where)
    where, choice = where[order], choice[order]
    rewards, feasible = map.values[choice, where], map.joints.feasible[choice, where]
    first, grid = map.reward.feasible_first, f"no plan on the grid of {len(map.thetas_rad)} positions"
    worst = rewards if feasible.all() or not first else rewards[~feasible]
    if feasible.all():
        certified = f"{grid} scores higher"
    elif first:
        certified = f"{grid} is feasible, and none has a better worst infeasible suture"
    else:
        certified = f"{grid} scores higher, within the joints' limits or not"
    directions, bound = np.array(DIRECTIONS)[choice], float(worst.min())
    return SuturePlan(map.thetas_rad[where], directions, rewards, bool(feasible.all()), bound, certified)


def refined(map: DexterityMap, plan: SuturePlan, spacing: Spacing) -> SuturePlan:
    """Return a plan at any angles that is at least as good as a plan on the map's grid that meets the spacing.

    It begins at the better of that plan and the best on a finer grid, since the dexterity has several maxima. A pattern
    search follows: a run of neighbouring sutures moves by a step, either way; the best such move is made or, if none is
    better, the step is halved. Neighbours move together because gaps at their bounds couple them. As on the grid, the
    worst suture counts; among infeasible plans, if the reward puts feasibility first, the worst infeasible one.
    """
    finer = _on_finer_grid(map, plan, spacing)
    thetas = finer.positions_rad
    n = len(thetas)
    runs = _runs(n)
    step = TURN / len(map.thetas_rad) / 2
    while step >= FINEST_RAD:
        shifts = step * np.concatenate([np.zeros((1, n)), runs, -runs])
        here, ahead, behind = np.split(np.arange(3 * n), 3)
        near = map.at(np.concatenate([thetas, thetas + step, thetas - step]))
        which = np.where(shifts > 0, ahead, np.where(shifts < 0, behind, here))
        scores = _scores(near.best[which], near.feasible[which], map.reward.feasible_first)
        kept = _meets(spacing, thetas + shifts)
        kept[0] = True  # the present plan stays allowed, in spite of rounding
        best = int(np.argmax(np.where(kept, scores, -np.inf)))
        if best:
            thetas = thetas + shifts[best]
        else:
            step /= 2
    thetas = np.sort(np.mod(thetas, TURN))
    at = map.at(thetas)
    return SuturePlan(thetas, at.directions, at.best, bool(at.feasible.all()), math.inf, UNPROVEN, plan.spacing)


def _on_finer_grid(map: DexterityMap, plan: SuturePlan, spacing: Spacing) -> SuturePlan:
    """Return the better of a plan and the best one on a finer grid; the plan itself if that grid would be too large."""
    positions, count = len(map.thetas_rad), len(plan.positions_rad)
    finer = min(FINER, MOST_POSITIONS // positions)
    if finer < 2:
        return plan
    fine = map.at(np.arange(finer * positions) * (TURN / (finer * positions)))
    found = plan_even(fine, count) if spacing == Spacing.even(count) else plan_gaps(fine, count, spacing)
    both = [map.at(one.positions_rad) for one in (plan, found)]
    rewards, feasible = np.stack([at.best for at in both]), np.stack([at.feasible for at in both])
    scores = _scores(rewards, feasible, map.reward.feasible_first)
    return found if scores[1] > scores[0] else plan


def _runs(n: int) -> NDArray[np.float64]:
    """Return which (m, n) of n sutures round the circle move together in each move: 1 for those that do."""
    first = np.eye(n)
    lengths = range(1, min(n - 1, LONGEST_RUN) + 1)
    runs = [sum(np.roll(first, k, axis=1) for k in range(length)) for length in lengths]
    return np.concatenate([*runs, np.ones((1, n))])


def _scores(rewards: NDArray[np.float64], feasible: NDArray[np.bool_], feasible_first: bool) -> NDArray[np.float64]:
    """Return the scores (m,) of plans (m, n); if feasibility comes first, infeasible ones are below all others."""
    worst = rewards.min(1)
    if not feasible_first:
        return worst
    return np.where(feasible.all(1), worst, np.where(feasible, np.inf, rewards).min(1) - 1e9)


def _meets(spacing: Spacing, thetas_rad: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which plans (m, n) meet the spacing."""
    gaps = np.diff(thetas_rad, append=thetas_rad[:, :1] + TURN)
    off = np.abs(np.mod(thetas_rad[..., None] - spacing.fixed_rad + np.pi, TURN) - np.pi).min(1)
    bounded = (gaps >= spacing.min_gap_rad - SLACK) & (gaps <= spacing.max_gap_rad + SLACK)
    return bounded.all(1) & spacing.allows(thetas_rad).all(1) & (off <= SLACK).all(1)
