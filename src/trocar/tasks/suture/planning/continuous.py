"""The general problem at any real angles, with a proven upper bound on every plan.

For a level t, the positions whose dexterity may reach t are enclosed by arcs (``enclosure``), bisected where the
dexterity crosses t. If no closed walk over these arcs exists (``arcs``, exact), no plan reaches t, so t bounds every
plan. If one exists, it is a plan, whose true value may be a new best. Bisection on t brings the two together.

Why the bound holds: (1) every position that reaches t lies in an arc whose upper bound is at least t, since intervals
enclose the closed form of the joints, rounding included. (2) Every plan that reaches t is therefore a closed walk over
these arcs with gaps within their bounds. (3) Each such walk has a place in the arc of starts that is searched, because
no gap is longer than this arc. (4) The places that k gaps reach from an interval of starts are computed as a set that
is never too small. If this set misses the starts one turn ahead, for all pieces of the arc of starts, there is no walk
and hence no plan. Sampling influences the plan, never the bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning.arcs import UNDECIDED, ArcWalks, Piece
from trocar.tasks.suture.planning.enclosure import DexterityEnclosure, ManipulabilityBounds
from trocar.tasks.suture.planning.gaps import check_closes, no_way, plan_gaps
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap

MAX_CELLS = 100_000
MAX_ROUNDS = 100
FINER = 4.0
ANY_LEVEL = -1e300
"""A level that every suture reaches: asking for it tells whether there is any plan."""
GAP_SLACK = 1e-10
"""Gaps may miss their bounds by this many rad, so that every plan on the grid is also one at real angles."""


class NoPlan(TrocarError):
    """No plan at any angles meets the spacing (and the limits, if the reward demands that), or none was found.

    Attributes:
        proven: whether it is proven that there is none.
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
    """Return a plan at real angles with a proven bound, at most ``tolerance`` above its value if the search converges.

    Dexterity is scaled as in the map. Gaps meet their bounds to a billionth of a rad. If the reward puts feasibility
    first, infeasible plans do not count.

    Args:
        map: setup, reward, scales, and the grid to start from.
        count: number of sutures.
        spacing: constraints on their positions, and the cost of uneven gaps.
        tolerance: gap to close between plan and bound, in units of dexterity.
        manipulability_bounds: smallest and largest M over arcs; needed if the map was given M as a function.

    Raises:
        NoPlan: there is none, or none was found; says which of the two.
        TrocarError: the gaps cannot add up to a turn, or the fixed positions contradict the other constraints.
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
    def value(self) -> float:
        """Return the value of the best plan so far; minus infinity without one."""
        return self.best.value if self.best else -math.inf

    def run(self, tolerance: float) -> None:
        """Raise the plan and lower the bound until they meet to within ``tolerance``, or the search gives up."""
        finest, step = tolerance / 20, 0.9 * tolerance
        if self.best is None and self._ask(ANY_LEVEL, finest) is None:
            self.bound = -math.inf
        # ``tried`` is the highest level not refuted so far; below the floor no level needs to be asked for.
        tried = self.value if self.best else self.cells.floor - tolerance
        proven = False
        for _ in range(MAX_ROUNDS):
            if self.bound - self.value <= tolerance or self.bound == -math.inf or self.cells.full:
                break
            if self.bound - tried <= tolerance / 20:
                # Bound and undecided level have met, but no plan was found there: ask again with finer arcs.
                tried, finest = max(self.value, self.cells.floor - tolerance), finest / FINER
            level = (tried + self.bound) / 2
            if not proven:
                # The first bound is far too high, so testing its middle is costly: take growing steps up from the plan.
                level, step = min(level, tried + step), 2 * step
            found = self._ask(level, finest)
            if found is None:
                self.bound, proven = level, True
            else:
                tried = max(level, self.value)

    def nothing(self) -> NoPlan:
        """Return the error to raise when there is no plan."""
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
        plan, cells = self.best, len(self.cells.start_rad)
        said = (
            f"no {'feasible ' if self.map.reward.feasible_first else ''}plan at any angles scores higher than the "
            f"bound, {self.bound - plan.value:.1g} above this plan: dexterity enclosed by intervals on {cells} arcs"
        )
        return replace(plan, bound=self.bound, certified=said)

    def _ask(self, level: float, finest_rad: float) -> list[float] | str | None:
        """Return a walk over arcs that may reach a level, ``UNDECIDED``, or None: no plan reaches the level.

        Tension makes the dexterity that a plan needs depend on how uneven its gaps are. Plans are therefore split by
        unevenness: in each class, from ``even`` to ``uneven``, gaps are bounded by the latter, and the dexterities must
        make up for the cost of the former, so that no plan is missed. Without tension there is one such class.
        """
        tension = self.spacing.tension
        pending = [(0.0, self.spacing.max_unevenness(self.count))]
        while pending:
            even, uneven = pending.pop()
            found = self._walk(level + tension * even, uneven, finest_rad)
            if found is None:
                continue
            if self.value >= level or tension * (uneven - even) <= finest_rad:
                return found
            middle = (even + uneven) / 2
            pending += [(even, middle), (middle, uneven)]
        return None

    def _walk(self, dexterity: float, unevenness: float, finest_rad: float) -> list[float] | str | None:
        """Return a walk over arcs that may have this dexterity, gaps at most this uneven; see ``ArcWalks.find``."""
        arcs, spacing, even = self.cells.superlevel_arcs(dexterity, finest_rad), self.spacing, TURN / self.count
        min_gap = max(spacing.min_gap_rad, even * (1 - unevenness)) - GAP_SLACK
        max_gap = min(spacing.max_gap_rad, even * (1 + unevenness)) + GAP_SLACK
        found = ArcWalks(tuple(arcs), self.count, min_gap, max_gap, spacing.fixed_rad).find(finest_rad)
        if found is not None and found != UNDECIDED:
            plan = plan_at(self.map, np.array(found, dtype=np.float64), spacing.tension)
            if plan.value > self.value and (plan.feasible or not self.map.reward.feasible_first):
                self.best = plan
        return found


class Cells:
    """Arcs round the circle, outside the forbidden ones, with bounds on the dexterity of the better direction.

    Attributes:
        start_rad: (c,) ascending.
        end_rad: (c,).
        upper: (c,) no suture on the arc has a larger dexterity; minus infinity where none can be feasible, if the
            reward puts feasibility first.
        lower: (c,) estimate of the smallest dexterity; it only steers the bisection.
    """

    def __init__(self, enclosure: DexterityEnclosure, spacing: Spacing) -> None:
        self.enclosure = enclosure
        edges = [0.0, TURN, *enclosure.map.thetas_rad, *np.ravel(spacing.forbidden_rad)]
        edges = np.unique(np.mod(edges, TURN).tolist() + [TURN])
        start, end = edges[:-1], edges[1:]
        kept = spacing.allows((start + end) / 2)
        self.start_rad, self.end_rad = start[kept], end[kept]
        self.upper, self.lower = self._bounds(self.start_rad, self.end_rad)

    @property
    def full(self) -> bool:
        """Return whether there are too many arcs to bisect further."""
        return len(self.start_rad) > MAX_CELLS

    @property
    def ceiling(self) -> float:
        """Return a dexterity that no suture exceeds."""
        return float(self.upper.max(initial=-math.inf))

    @property
    def floor(self) -> float:
        """Return the lowest level that is useful to ask for."""
        finite = self.lower[np.isfinite(self.lower)]
        return float(finite.min()) if len(finite) else 0.0

    def superlevel_arcs(self, level: float, finest_rad: float) -> list[Piece]:
        """Return arcs that hold every suture whose dexterity reaches a level.

        Arcs on which the dexterity may cross the level are bisected, down to the width ``finest_rad``.
        """
        while not self.full:
            crossing = (self.upper >= level) & (self.lower < level) & (self.end_rad - self.start_rad > finest_rad)
            if not crossing.any():
                break
            self._bisect(crossing)
        taken = self.upper >= level
        joined: list[Piece] = []
        for start, end in zip(self.start_rad[taken].tolist(), self.end_rad[taken].tolist(), strict=True):
            if joined and start == joined[-1][1]:
                joined[-1] = (joined[-1][0], end)
            else:
                joined.append((start, end))
        return joined

    def _bisect(self, which: NDArray[np.bool_]) -> None:
        start, end = self.start_rad[which], self.end_rad[which]
        middle = (start + end) / 2
        halves = np.concatenate([start, middle]), np.concatenate([middle, end])
        bounds = self._bounds(*halves)
        new = [
            np.concatenate([old[~which], part])
            for old, part in zip(
                (self.start_rad, self.end_rad, self.upper, self.lower), (*halves, *bounds), strict=True
            )
        ]
        order = np.argsort(new[0])
        self.start_rad, self.end_rad, self.upper, self.lower = (values[order] for values in new)

    def _bounds(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        """Return upper and lower bounds (c,), (c,) over arcs, of the better direction."""
        bounds = self.enclosure.over(start, end)
        if not self.enclosure.map.reward.feasible_first:
            return bounds.upper.max(0), bounds.lower.max(0)
        upper = np.where(bounds.possible, bounds.upper, -np.inf).max(0)
        return upper, np.where(bounds.certain, bounds.lower, -np.inf).max(0)


def plan_at(map: DexterityMap, thetas_rad: NDArray[np.float64], tension: float = 0.0) -> SuturePlan:
    """Return the plan with sutures at these angles, each in its better direction; its bound is infinite."""
    thetas = np.sort(np.mod(thetas_rad, TURN))
    here = map.at(thetas)
    plan = SuturePlan(thetas, here.directions, here.best, bool(here.feasible.all()), math.inf, "nothing is proven")
    return replace(plan, tension_cost=tension * plan.unevenness)


def _on_grid(map: DexterityMap, count: int, spacing: Spacing) -> SuturePlan | None:
    """Return the best plan on the grid, or None if there is none that counts."""
    try:
        plan = plan_gaps(map, count, spacing)
    except TrocarError:  # fixed positions off the grid, or gaps that its steps cannot make
        return None
    return plan if plan.feasible or not map.reward.feasible_first else None
