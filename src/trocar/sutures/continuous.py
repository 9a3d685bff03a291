"""The general problem at any real angles, with a proven bound on what no plan can exceed.

For a value t, the positions whose dexterity may reach t are enclosed by arcs (``enclosure``), bisected where t is
crossed. If no closed walk over these arcs exists (``arcs``, exact), no plan is worth t: t bounds every plan. If one
exists, its real dexterity is a plan's, perhaps a new best one's. Bisection on t brings the two together.

Why the bound holds: (1) every position worth t lies in an arc whose upper bound is at least t, as intervals enclose the
closed form of the joints, rounding included. (2) Every plan worth t is thus a closed walk over these arcs with gaps
within their bounds. (3) Each such walk has a place in the arc of starts that is searched: no gap is longer than it.
(4) What k gaps reach from an interval of starts is computed as a set, never too small. So if it misses the starts one
turn ahead, for all pieces of the arc of starts, there is no walk, hence no plan. Sampling enters the plan, not the
bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.sutures.arcs import UNDECIDED, ArcWalks, Piece
from trocar.sutures.enclosure import DexterityEnclosure, ManipulabilityBounds
from trocar.sutures.gaps import check_closes, no_way, plan_gaps
from trocar.sutures.plan import TURN, Spacing, SuturePlan
from trocar.sutures.rewards import DexterityMap

MOST_CELLS = 100_000
MOST_ROUNDS = 100
FINER = 4.0
WHATEVER = -1e300
"""Every suture that counts is worth as much: asked for to find out whether there is any plan."""
GAP_SLACK = 1e-10
"""Gaps may miss their bounds by this many rad, so that every plan on the grid is one of the continuum."""


class NoPlan(TrocarError):
    """No plan at any angles meets the spacing and is feasible, where the reward puts that first; or none was found.

    Attributes:
        proven: whether there is none.
    """

    def __init__(self, sentence: str, proven: bool) -> None:
        super().__init__(sentence)
        self.proven = proven


def plan_continuous(
    map: DexterityMap,
    count: int,
    spacing: Spacing,
    tolerance: float = 1e-3,
    manipulability_bounds: ManipulabilityBounds | None = None,
) -> SuturePlan:
    """Return a plan at real angles, and a proven bound at most ``tolerance`` above its worth where that can be had.

    Dexterity is that of the map, with its scales. Gaps hold to a billionth of a rad. Where the reward puts feasibility
    first, plans that are not feasible do not count.

    Args:
        map: setup, reward, scales, and the grid to begin with.
        count: of sutures.
        spacing: of their places, and what uneven gaps cost.
        tolerance: of the bound, in units of dexterity.
        manipulability_bounds: where M was given to the map, its least and largest values over arcs.

    Raises:
        NoPlan: there is none, or none was found; says which of the two.
        TrocarError: the gaps cannot add up to a turn, or the fixed positions contradict the rest.
    """
    check_closes(count, spacing)
    if not 1e-9 <= tolerance <= 1.0:
        raise TrocarError(f"the tolerance of the bound is {tolerance:g}; give 1e-9 to 1")
    cells = Cells(DexterityEnclosure(map, manipulability_bounds), spacing)
    search = _Search(map, count, spacing, cells, _on_grid(map, count, spacing), cells.ceiling)
    search.run(tolerance)
    if search.best is None:
        raise search.nothing()
    return search.certified()


@dataclass(eq=False)
class _Search:
    """The best plan and the proven bound so far."""

    map: DexterityMap
    count: int
    spacing: Spacing
    cells: Cells
    best: SuturePlan | None
    bound: float

    @property
    def worth(self) -> float:
        """Return what the best plan so far is worth; minus infinity without one."""
        return self.best.worth if self.best else -math.inf

    def run(self, tolerance: float) -> None:
        """Bring bound and plan together."""
        finest, step = tolerance / 20, 0.9 * tolerance
        if self.best is None and self._ask(WHATEVER, finest) is None:
            self.bound = -math.inf
        tried = self.worth if self.best else self.cells.floor - tolerance  # below it nothing is asked any more
        proven = False
        for _ in range(MOST_ROUNDS):
            if self.bound - self.worth <= tolerance or self.bound == -math.inf or self.cells.full:
                break
            if self.bound - tried <= tolerance / 20:
                tried, finest = max(self.worth, self.cells.floor - tolerance), finest / FINER
            value = (tried + self.bound) / 2
            if not proven:
                value, step = min(value, tried + step), 2 * step
            found = self._ask(value, finest)
            if found is None:
                self.bound, proven = value, True
            else:
                tried = max(value, self.worth)

    def nothing(self) -> NoPlan:
        """Return what to raise without a plan."""
        where = "within the joints' limits" if self.map.reward.feasible_first else "at any angles"
        if self.bound == -math.inf:
            return NoPlan(no_way(self.count, self.spacing, where), proven=True)
        return NoPlan(
            f"no {self.count} sutures {where} were found for this spacing, though it is not proven that there are "
            "none; widen the gaps' bounds, or move the circle or the base",
            proven=False,
        )

    def certified(self) -> SuturePlan:
        """Return the best plan with its bound."""
        assert self.best is not None
        plan, number = self.best, len(self.cells.start)
        said = (
            f"no {'feasible ' if self.map.reward.feasible_first else ''}plan at any angles is worth more, which is "
            f"{self.bound - plan.worth:.1g} above this one: dexterity enclosed by intervals on {number} arcs"
        )
        return replace(plan, bound=self.bound, certified=said)

    def _ask(self, value: float, finest: float) -> list[float] | str | None:
        """Return a walk over what may be worth a value, ``UNDECIDED``, or None: no plan is worth as much.

        Plans are asked for by how uneven their gaps are, from ``even`` to ``uneven``: their gaps lie within the latter,
        their dexterities must make up for what the former costs. Without tension there is one such question.
        """
        tension = self.spacing.tension
        pending = [(0.0, self.spacing.most_uneven(self.count))]
        while pending:
            even, uneven = pending.pop()
            found = self._walk(value + tension * even, uneven, finest)
            if found is None:
                continue
            if self.worth >= value or tension * (uneven - even) <= finest:
                return found
            middle = (even + uneven) / 2
            pending += [(even, middle), (middle, uneven)]
        return None

    def _walk(self, dexterity: float, uneven: float, finest: float) -> list[float] | str | None:
        """Return a walk over what may have a dexterity, with gaps that uneven at most, as ``ArcWalks.find`` does."""
        arcs, spacing, even = self.cells.worth(dexterity, finest), self.spacing, TURN / self.count
        least = max(spacing.least_gap_rad, even * (1 - uneven)) - GAP_SLACK
        most = min(spacing.most_gap_rad, even * (1 + uneven)) + GAP_SLACK
        found = ArcWalks(tuple(arcs), self.count, least, most, spacing.fixed_rad).find(finest)
        if found is not None and found != UNDECIDED:
            plan = plan_at(self.map, np.array(found, dtype=np.float64), spacing.tension)
            if plan.worth > self.worth and (plan.feasible or not self.map.reward.feasible_first):
                self.best = plan
        return found


class Cells:
    """Arcs round the circle, outside the forbidden ones, with bounds on the dexterity of the better direction.

    Attributes:
        start: (c,) ascending, rad.
        end: (c,).
        most: (c,) no suture on the arc is worth more; minus infinity where none can be feasible and has to be.
        least: (c,) what steers the bisection.
    """

    def __init__(self, enclosure: DexterityEnclosure, spacing: Spacing) -> None:
        self.enclosure = enclosure
        edges = [0.0, TURN, *enclosure.map.thetas_rad, *np.ravel(spacing.forbidden_rad)]
        edges = np.unique(np.mod(edges, TURN).tolist() + [TURN])
        start, end = edges[:-1], edges[1:]
        kept = spacing.allows((start + end) / 2)
        self.start, self.end = start[kept], end[kept]
        self.most, self.least = self._bounds(self.start, self.end)

    @property
    def full(self) -> bool:
        """Return whether there are too many to go on."""
        return len(self.start) > MOST_CELLS

    @property
    def ceiling(self) -> float:
        """Return what no suture exceeds."""
        return float(self.most.max(initial=-math.inf))

    @property
    def floor(self) -> float:
        """Return a value below which there is nothing to tell apart."""
        finite = self.least[np.isfinite(self.least)]
        return float(finite.min()) if len(finite) else 0.0

    def worth(self, value: float, finest: float) -> list[Piece]:
        """Return arcs outside of which no suture is worth a value, bisecting those that cross it down to ``finest``."""
        while not self.full:
            crossing = (self.most >= value) & (self.least < value) & (self.end - self.start > finest)
            if not crossing.any():
                break
            self._bisect(crossing)
        taken = self.most >= value
        joined: list[Piece] = []
        for start, end in zip(self.start[taken].tolist(), self.end[taken].tolist(), strict=True):
            if joined and start == joined[-1][1]:
                joined[-1] = (joined[-1][0], end)
            else:
                joined.append((start, end))
        return joined

    def _bisect(self, which: NDArray[np.bool_]) -> None:
        start, end = self.start[which], self.end[which]
        middle = (start + end) / 2
        halves = np.concatenate([start, middle]), np.concatenate([middle, end])
        bounds = self._bounds(*halves)
        new = [
            np.concatenate([old[~which], part])
            for old, part in zip((self.start, self.end, self.most, self.least), (*halves, *bounds), strict=True)
        ]
        order = np.argsort(new[0])
        self.start, self.end, self.most, self.least = (values[order] for values in new)

    def _bounds(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        bounds = self.enclosure.over(start, end)
        if not self.enclosure.map.reward.feasible_first:
            return bounds.most.max(0), bounds.least.max(0)
        most = np.where(bounds.can, bounds.most, -np.inf).max(0)
        return most, np.where(bounds.must, bounds.least, -np.inf).max(0)


def plan_at(map: DexterityMap, thetas_rad: NDArray[np.float64], tension: float = 0.0) -> SuturePlan:
    """Return the plan with sutures at these angles, each in its better direction; bounded by nothing."""
    thetas = np.sort(np.mod(thetas_rad, TURN))
    here = map.at(thetas)
    plan = SuturePlan(thetas, here.directions, here.best, bool(here.feasible.all()), math.inf, "nothing is proven")
    return replace(plan, tension_cost=tension * plan.uneven)


def _on_grid(map: DexterityMap, count: int, spacing: Spacing) -> SuturePlan | None:
    """Return the best plan on the grid, if there is one that counts."""
    try:
        plan = plan_gaps(map, count, spacing)
    except TrocarError:  # fixed positions off the grid, or gaps that it cannot make
        return None
    return plan if plan.feasible or not map.reward.feasible_first else None
