"""A plan of sutures round the circle, and what is asked of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.sutures.rewards import DexterityMap
from trocar.sutures.setup import DIRECTIONS

TURN = 2 * math.pi
MOST_SUTURES = 360


@dataclass(frozen=True, eq=False)
class SuturePlan:
    """Where the sutures go and in which direction each is driven.

    Attributes:
        positions_rad: (n,) ascending, in [0, 2 pi).
        directions: (n,) of ``DIRECTIONS``.
        rewards: (n,) dexterity of each suture.
        feasible: whether every suture stays within the joints' limits and at the safe depth.
        bound: no plan of this problem has a larger ``worth``; proven, not sampled. If none is feasible, though the
            reward puts that first, no plan's worst infeasible suture is better, less the cost of tension.
        certified: what ``bound`` holds for, in words.
        tension_cost: what uneven gaps cost (``Spacing.tension``).
    """

    positions_rad: NDArray[np.float64]
    directions: NDArray[np.intp]
    rewards: NDArray[np.float64]
    feasible: bool
    bound: float
    certified: str
    tension_cost: float = 0.0

    @property
    def reward(self) -> float:
        """Return the dexterity of the worst suture (paper, III-D3)."""
        return float(self.rewards.min())

    @property
    def worth(self) -> float:
        """Return the reward less the cost of uneven gaps: what planners make large, if any plan is feasible."""
        return self.reward - self.tension_cost

    @property
    def gaps_rad(self) -> NDArray[np.float64]:
        """Return the gap (n,) from each suture on to the next; they add up to a whole turn."""
        return np.diff(self.positions_rad, append=self.positions_rad[0] + TURN)

    @property
    def uneven(self) -> float:
        """Return the largest departure of a gap from the even one, as a share of it."""
        even = TURN / len(self.positions_rad)
        return float(np.abs(self.gaps_rad - even).max()) / even


@dataclass(frozen=True)
class Spacing:
    """What is asked of the places of the sutures.

    Attributes:
        least_gap_rad: between neighbours.
        most_gap_rad: between neighbours.
        forbidden_rad: arcs (from, to), counterclockwise, within which no suture may stand; their ends are allowed.
        fixed_rad: where sutures must stand.
        tension: what is taken off the worst dexterity for each unit of uneven mesh tension: the largest
            ``|gap - even gap| / even gap`` of the plan.
    """

    least_gap_rad: float
    most_gap_rad: float
    forbidden_rad: tuple[tuple[float, float], ...] = ()
    fixed_rad: tuple[float, ...] = ()
    tension: float = 0.0

    def __post_init__(self) -> None:
        least, most = self.least_gap_rad, self.most_gap_rad
        if not (math.isfinite(least) and math.isfinite(most) and 0 < least <= most <= TURN):
            raise TrocarError(
                f"the gaps between sutures are bounded by {math.degrees(least):g} and {math.degrees(most):g} deg; "
                "give a least gap above 0, at most the largest, which is at most 360 deg"
            )
        if not (math.isfinite(self.tension) and self.tension >= 0):
            raise TrocarError(f"the tension weight is {self.tension:g}; give a finite number of at least 0")
        object.__setattr__(self, "forbidden_rad", tuple(_arc(arc) for arc in self.forbidden_rad))
        fixed = _angles("the fixed positions", self.fixed_rad) % TURN
        object.__setattr__(self, "fixed_rad", tuple(sorted(set(fixed.tolist()))))

    @staticmethod
    def even(count: int) -> Spacing:
        """Return the paper's: every gap alike."""
        return Spacing(TURN / count, TURN / count)

    def most_uneven(self, count: int) -> float:
        """Return the largest departure of a gap from the even one that the bounds allow, as a share of it."""
        even = TURN / count
        return max(self.most_gap_rad - even, even - self.least_gap_rad, 0.0) / even

    def allows(self, thetas_rad: ArrayLike) -> NDArray[np.bool_]:
        """Return which of these positions (n,) lie outside every forbidden arc."""
        thetas = np.asarray(thetas_rad, dtype=np.float64)
        allowed = np.ones(thetas.shape, dtype=bool)
        for start, end in self.forbidden_rad:
            into = np.mod(thetas - start, TURN)
            allowed &= (into <= 1e-9) | (into >= (end - start) - 1e-9)
        return allowed


def check_count(count: int) -> None:
    """Raise a sentence unless ``count`` sutures can be planned."""
    if count not in range(1, MOST_SUTURES + 1):
        raise TrocarError(f"the number of sutures is {count}; give a whole number from 1 to {MOST_SUTURES}")


def ranks(map: DexterityMap) -> NDArray[np.intp]:
    """Return ranks (2, n) of all sutures, 0 the worst: by feasibility if the reward says so, then by dexterity.

    Where dexterity ties, as with lambda = 0, the joint margin decides. The plan whose worst suture ranks highest is the
    lexicographic optimum: a plan that is feasible beats any that is not, then the worst suture counts.
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
    """Return the plan with sutures at these positions of the map, in these rows of ``DIRECTIONS``: the best there is.

    Args:
        map: what the sutures are worth.
        where: (n,) indices of positions.
        choice: (n,) rows of directions.
        tension_cost: of uneven gaps.
    """
    order = np.argsort(where)
    where, choice = where[order], choice[order]
    rewards, can = map.values[choice, where], map.joints.feasible[choice, where]
    worst = rewards if can.all() or not map.reward.feasible_first else rewards[~can]
    said = f"no plan on the grid of {len(map.thetas_rad)} positions is worth more"
    if not can.all():
        said = (
            f"no plan on the grid of {len(map.thetas_rad)} positions is feasible; of the others, none has a better "
            "worst infeasible suture"
            if map.reward.feasible_first
            else said + ", within the joints' limits or not"
        )
    return SuturePlan(
        map.thetas_rad[where],
        np.array(DIRECTIONS)[choice],
        rewards,
        bool(can.all()),
        float(worst.min()) - tension_cost,
        said,
        tension_cost,
    )


def _angles(what: str, values: Sequence[float]) -> NDArray[np.float64]:
    """Return finite angles, or raise a sentence."""
    try:
        angles = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        angles = np.array(np.nan)
    if angles.ndim != 1:
        raise TrocarError(f"{what} are {values!r}; give finite angles in rad, as in (0.0, 1.57)")
    if not np.isfinite(angles).all():
        said = ", ".join(f"{math.degrees(angle):g}" for angle in angles)
        raise TrocarError(f"{what} are {said} deg; give finite angles")
    return angles


def _arc(arc: Sequence[float]) -> tuple[float, float]:
    """Return a forbidden arc with 0 <= from < 2 pi and from < to <= from + 2 pi, or raise a sentence."""
    angles = _angles("the ends of a forbidden arc", arc)
    if angles.shape != (2,):
        raise TrocarError(f"a forbidden arc is {arc!r}; give two angles in rad, from and to, counterclockwise")
    start, length = float(angles[0] % TURN), float((angles[1] - angles[0]) % TURN)
    if length == 0.0 or abs(angles[1] - angles[0]) > TURN:
        raise TrocarError(
            f"a forbidden arc goes from {math.degrees(angles[0]):g} to {math.degrees(angles[1]):g} deg; "
            "its ends must differ by less than a whole turn"
        )
    return start, start + length
