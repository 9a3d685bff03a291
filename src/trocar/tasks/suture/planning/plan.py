"""A plan of sutures round the circle, and the constraints on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry import TURN, shown
from trocar.geometry.arrays import finite
from trocar.notebook import table
from trocar.tasks.suture.planning.rewards import DexterityMap
from trocar.tasks.suture.planning.setup import DIRECTION_NAMES, DIRECTIONS

MAX_SUTURES = 360


@dataclass(frozen=True, eq=False)
class SuturePlan:
    """Where the sutures lie and in which direction each is driven.

    Attributes:
        positions_rad: (n,) ascending, in [0, 2 pi).
        directions: (n,) each one of ``DIRECTIONS``.
        rewards: (n,) dexterity of each suture.
        feasible: whether every suture stays within the joints' limits and keeps the safe depth.
        bound: proven upper bound on the ``value`` of all plans on the grid; infinite for plans at any angles. If no
            plan is feasible although the reward puts feasibility first, it bounds the worst infeasible suture of all
            plans, minus the tension cost.
        certified: which plans ``bound`` covers, in words.
        tension_cost: cost of uneven gaps (``Spacing.tension``).
    """

    positions_rad: NDArray[np.float64]
    directions: NDArray[np.intp]
    rewards: NDArray[np.float64]
    feasible: bool
    bound: float
    certified: str
    tension_cost: float = 0.0

    def __repr__(self) -> str:
        kept = "within the limits" if self.feasible else "BEYOND the limits"
        count = len(self.positions_rad)
        return f"<SuturePlan of {count} sutures: reward {self.reward:.4f}, bound {self.bound:.4f}, {kept}>"

    def _repr_html_(self) -> str:
        rows = (
            (number, shown(theta, "rad"), DIRECTION_NAMES[int(direction)], f"{reward:.4f}")
            for number, (theta, direction, reward) in enumerate(
                zip(self.positions_rad, self.directions, self.rewards, strict=True), start=1
            )
        )
        return table(self, ("suture", "position", "direction", "dexterity"), rows)

    @property
    def reward(self) -> float:
        """Return the dexterity of the worst suture (paper, III-D3)."""
        return float(self.rewards.min())

    @property
    def value(self) -> float:
        """Return the reward minus the cost of uneven gaps, which planners maximise if any plan is feasible."""
        return self.reward - self.tension_cost

    @property
    def gaps_rad(self) -> NDArray[np.float64]:
        """Return the gap (n,) from each suture to the next; gaps add up to a whole turn."""
        return np.diff(self.positions_rad, append=self.positions_rad[0] + TURN)

    @property
    def unevenness(self) -> float:
        """Return the largest difference between a gap and the even gap, as a share of the even gap."""
        even = TURN / len(self.positions_rad)
        return float(np.abs(self.gaps_rad - even).max()) / even


@dataclass(frozen=True)
class Spacing:
    """Constraints on the positions of the sutures.

    Attributes:
        min_gap_rad: smallest gap between neighbours.
        max_gap_rad: largest gap between neighbours.
        forbidden_rad: arcs (from, to), counterclockwise, without sutures; their ends are allowed.
        fixed_rad: positions that must hold a suture.
        tension: weight of uneven mesh tension; the plan's largest ``|gap - even gap| / even gap``, times this weight,
            is subtracted from its worst dexterity.
    """

    min_gap_rad: float
    max_gap_rad: float
    forbidden_rad: tuple[tuple[float, float], ...] = ()
    fixed_rad: tuple[float, ...] = ()
    tension: float = 0.0

    def __post_init__(self) -> None:
        low, high = self.min_gap_rad, self.max_gap_rad
        if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high <= TURN):
            raise InvalidInput(
                "the gaps between sutures",
                f"are bounded by {shown(low, 'rad', 'g')} and {shown(high, 'rad', 'g')}",
                "give a smallest gap above 0 and at most the largest, and a largest gap of at most 360 deg",
            )
        if not (math.isfinite(self.tension) and self.tension >= 0):
            raise InvalidValue("the tension weight", f"{self.tension:g}", "give a finite number of at least 0")
        object.__setattr__(self, "forbidden_rad", tuple(_arc(arc) for arc in self.forbidden_rad))
        fixed = finite("the fixed positions in rad", self.fixed_rad, "n") % TURN
        object.__setattr__(self, "fixed_rad", tuple(sorted(set(fixed.tolist()))))

    @staticmethod
    def even(count: int) -> Spacing:
        """Return the spacing of the paper: all gaps equal."""
        return Spacing(TURN / count, TURN / count)

    def allows(self, thetas_rad: ArrayLike) -> NDArray[np.bool_]:
        """Return which positions (n,) lie outside all forbidden arcs."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        allowed = np.ones(thetas.shape, dtype=bool)
        for start, end in self.forbidden_rad:
            into = np.mod(thetas - start, TURN)
            allowed &= (into <= 1e-9) | (into >= (end - start) - 1e-9)
        return allowed


Planner = Callable[[DexterityMap], SuturePlan]
"""Makes the best plan of a map."""


def check_count(count: int) -> None:
    """Raise InvalidValue unless ``count`` sutures can be planned."""
    if count not in range(1, MAX_SUTURES + 1):
        raise InvalidValue("the number of sutures", count, f"give a whole number from 1 to {MAX_SUTURES}")


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


def plan_on_grid(
    map: DexterityMap, where: NDArray[np.intp], choice: NDArray[np.intp], tension_cost: float = 0.0
) -> SuturePlan:
    """Return the optimal plan that a search on the grid found, with its bound.

    Args:
        map: dexterity of the sutures on the grid.
        where: (n,) indices of the plan's positions.
        choice: (n,) rows of the plan's directions in ``DIRECTIONS``.
        tension_cost: cost of uneven gaps.
    """
    order = np.argsort(where)
    where, choice = where[order], choice[order]
    rewards, feasible = map.values[choice, where], map.joints.feasible[choice, where]
    worst = rewards if feasible.all() or not map.reward.feasible_first else rewards[~feasible]
    grid = f"no plan on the grid of {len(map.thetas_rad)} positions"
    if feasible.all():
        certified = f"{grid} scores higher"
    elif map.reward.feasible_first:
        certified = f"{grid} is feasible, and none has a better worst infeasible suture"
    else:
        certified = f"{grid} scores higher, within the joints' limits or not"
    return SuturePlan(
        map.thetas_rad[where],
        np.array(DIRECTIONS)[choice],
        rewards,
        bool(feasible.all()),
        float(worst.min()) - tension_cost,
        certified,
        tension_cost,
    )


def _arc(arc: Sequence[float]) -> tuple[float, float]:
    """Return a forbidden arc with 0 <= from < 2 pi and from < to < from + 2 pi."""
    angles = finite("the ends of a forbidden arc in rad", arc, 2)
    start, length = float(angles[0] % TURN), float((angles[1] - angles[0]) % TURN)
    if length == 0.0 or abs(angles[1] - angles[0]) > TURN:
        raise InvalidInput(
            "a forbidden arc",
            f"goes from {shown(angles[0], 'rad', 'g')} to {shown(angles[1], 'rad', 'g')}",
            "its ends must differ by less than a whole turn",
        )
    return start, start + length
