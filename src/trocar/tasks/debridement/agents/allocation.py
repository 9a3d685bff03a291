"""Which arm takes which fragment, and what the arms know of the work surface together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.robots.coordinator import Coordinator
from trocar.tasks.debridement.goals import Workspace
from trocar.tasks.debridement.perception.fragments import SAME_M, SeenFragment

BESIDE_REGION_M = 0.025
"""Fragments that rolled, or were pushed, may be this far outside the region in which they were laid."""
IN_THE_AIR_M = 0.014  # anything seen this high above the work surface is held by jaws, or lies in the receptacle
FULL_FRAGMENTS = 3
"""A receptacle is full if this many fragments stand out of it; one may lie on another long before that."""
FULL_LOOKS = 3  # this many looks in a row have to show it, since fragments are also seen while they fall
FULL_M = 3e-3
"""A fragment whose middle is this close to the height of the receptacle's edge lies on others; higher up, jaws hold
it."""
IN_JAWS_M = 0.025
"""A fragment seen this close to a tip may be in the jaws: fingers end 10 mm beyond it, and fragments stick out."""
ONE_M = 0.007
"""Two fragments seen this close to each other are parts of one that a finger in front divides; the paper's program
merges them too."""
MOST_AHEAD = 7  # arms think ahead once at most this many fragments are left, because the orders multiply
PATIENCE_S = 20.0  # a place where an arm failed is avoided for this long, if there is another one


class Failure(NamedTuple):
    """A fragment that an arm did not clear: where it lay (3,), when, and whether the arm found no path."""

    arm: str
    p_world_m: NDArray[np.float64]
    time_s: float
    blocked: bool


@dataclass
class Allocation:
    """Fragments that arms have claimed, cleared and failed at; all arms share it."""

    coordinator: Coordinator  # of the arms
    workspace: Workspace  # what is known of the work surface
    T_world_table: SE3  # the work surface
    T_world_receptacle: SE3  # where the receptacle is
    goals: int  # how many fragments are to be cleared
    claimed: dict[str, NDArray[np.float64]] = field(default_factory=dict)  # place of each arm's fragment
    busy: set[str] = field(default_factory=set)  # arms that are not done
    cleared: int = 0  # fragments that arms let go over the receptacle
    failures: list[Failure] = field(default_factory=list)  # what went wrong, where and when
    changes: int = 0  # how often what arms have claimed has changed
    _full: int = 0

    def loose(self, fragments: Sequence[SeenFragment]) -> list[SeenFragment]:
        """Return the fragments on the work surface outside the receptacle; of the parts of one, the largest."""
        low, high = np.sort(self.workspace.region_m, axis=0) + [[-BESIDE_REGION_M], [BESIDE_REGION_M]]
        T_receptacle_world, table_m = self.T_world_receptacle.inverse(), self.T_world_table.translation_m[2]
        lying = [
            f
            for f in fragments
            if ((low < f.p_world_m[:2]) & (f.p_world_m[:2] < high)).all()
            and f.p_world_m[2] - table_m < IN_THE_AIR_M
            and not self.workspace.receptacle.holds(T_receptacle_world.apply(f.p_world_m))
        ]
        return [f for f in lying if not any(f.away_m(g.p_world_m) < ONE_M and g.area_px > f.area_px for g in lying)]

    def full(self, fragments: Sequence[SeenFragment], p_world_tips: Sequence[NDArray[np.float64]]) -> bool:
        """Return whether fragments stand out of the receptacle; those near a tip (3,) may be in its jaws."""
        shape, half_m = self.workspace.receptacle, 0.5 * np.array(self.workspace.receptacle.size_m)
        places = [(f, self.T_world_receptacle.inverse().apply(f.p_world_m)) for f in fragments]
        high = [f for f, p in places if (np.abs(p[:2]) < half_m).all() and abs(p[2] - shape.height_m) < FULL_M]
        lying = [f for f in high if all(np.linalg.norm(f.p_world_m - tip) >= IN_JAWS_M for tip in p_world_tips)]
        if len(lying) >= FULL_FRAGMENTS:
            self._full += 1
            return self._full >= FULL_LOOKS
        if len(high) < FULL_FRAGMENTS:
            self._full = 0
        return False

    def over_receptacle(self, p_world_m: NDArray[np.float64], inside_m: float) -> bool:
        """Return whether a place (3,) is over the receptacle, at least this far from its walls."""
        away = np.abs(self.T_world_receptacle.inverse().apply(p_world_m)[:2])
        return bool((away < 0.5 * np.array(self.workspace.receptacle.size_m) - inside_m).all())

    def choices(
        self, arm: str, side: int, fragments: Sequence[SeenFragment], apart_m: float, now_s: float, ahead: bool = True
    ) -> list[SeenFragment]:
        """Return the fragments that an arm may take, the outermost on its side (+1 at +x, -1) first (V-C.2).

        With ``ahead``, those come first after which the arms, in turn, get least in each other's way. Places where it
        failed recently come last; those to which it found no path are left to the other arm, if that is still working.
        """
        others = [place for name, place in self.claimed.items() if name != arm]
        free = [f for f in fragments if all(f.away_m(place) > apart_m for place in others)]
        free.sort(key=lambda f: -side * float(f.p_world_m[0]))
        left = [f for f in fragments if all(f.away_m(place) > SAME_M for place in others)]
        if ahead and self.busy - {arm} and len(left) <= MOST_AHEAD:
            free.sort(key=lambda f: _clashes(f, [other for other in left if other is not f], -side, apart_m))
        recent = [failure for failure in self.failures if now_s - failure.time_s < PATIENCE_S]
        if self.busy - {arm}:
            blocked = [failure for failure in recent if failure.blocked and failure.arm == arm]
            free = [f for f in free if all(f.away_m(failure.p_world_m) >= SAME_M for failure in blocked)]
        bad = [f for f in free if any(f.away_m(failure.p_world_m) < SAME_M for failure in recent)]
        return [f for f in free if f not in bad] + bad

    def failures_at(self, place: NDArray[np.float64]) -> int:
        """Return the number of failures at a place."""
        return sum(float(np.linalg.norm(place[:2] - f.p_world_m[:2])) < SAME_M for f in self.failures)

    def claim(self, arm: str, place: NDArray[np.float64] | None) -> None:
        """Note which place (3,) an arm works at; None: at none."""
        if place is None:
            self.claimed.pop(arm, None)
        else:
            self.claimed[arm] = place
        self.changes += 1
        self.coordinator.progress()

    def carry(self, arm: str) -> None:
        """Note that an arm has left the work surface with its fragment."""
        self.claim(arm, self.T_world_receptacle.translation_m)


def _clashes(taken: SeenFragment, left: Sequence[SeenFragment], side: int, apart_m: float) -> int:
    """Return how often arms that take turns, that of ``side`` next, clash in the best order of what is left.

    They clash at two fragments in a row that are closer together than ``apart_m``, or where each arm would have to
    reach past the other one.
    """
    places = [f.p_world_m[:2] for f in (taken, *left)]

    @cache
    def least(last: int, among: frozenset[int], side: int) -> int:
        return min((clash(last, one, side) + least(one, among - {one}, -side) for one in among), default=0)

    def clash(last: int, one: int, side: int) -> int:
        off = places[one] - places[last]
        return int(np.linalg.norm(off) <= apart_m) + int(side * off[0] < 0)

    return least(0, frozenset(range(1, len(places))), side)
