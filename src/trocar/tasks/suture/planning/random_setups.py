"""Statistics over random setups: what holds in general, not only for one setup."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning.joints import SutureJoints, suture_joints
from trocar.tasks.suture.planning.parameters import RANGES, with_parameters
from trocar.tasks.suture.planning.rewards import MARGINS, DexterityMap, Reward, scored
from trocar.tasks.suture.planning.setup import SutureSetup
from trocar.tasks.suture.planning.study import ALLOWED, LOCATIONS, PAPER_TABLE_1, table_1

DRAWN = tuple(name for name in RANGES if not name.startswith(("center", "base_sideways")))
"""Parameters drawn uniformly from their ranges; the distance of the base follows from the circle."""

CLEARANCE_M = (0.010, 0.050)
"""How far outside the circle the base stands, seen from above; the paper's arm is mounted beside the phantom."""

COARSE = 12
"""Positions tested first: most setups already fail there."""

DRAWS_PER_SETUP = 100
"""Maximum number of draws per requested feasible setup."""

MEASURES: dict[str, Reward] = {
    **{name: Reward(margin=name, at="stations", feasible_first=False) for name in MARGINS},
    "default": Reward(),
}
"""Rewards compared: each margin formula at the stations and without regard to limits, as in the paper; the default."""


def random_setup(rng: np.random.Generator, holdable: bool = False) -> SutureSetup:
    """Return a setup with all parameters drawn uniformly from ``RANGES``, the base ``CLEARANCE_M`` outside the circle.

    Args:
        rng: random generator.
        holdable: whether flat jaws must be able to hold the needle as grasped: the skew is then 0 or half a turn.
    """
    values = {name: float(rng.uniform(RANGES[name].low, RANGES[name].high)) for name in DRAWN}
    values["base_sideways_m"] = values["circle_radius_m"] + float(rng.uniform(*CLEARANCE_M))
    if holdable:
        values["grasp_skew_rad"] = float(rng.integers(2)) * np.pi
    return with_parameters(SutureSetup(), values)


def reaches_everywhere(joints: SutureJoints) -> bool:
    """Return whether each position has at least one feasible direction: this makes a setup *feasible*."""
    return bool(joints.feasible.any(0).all())


@dataclass(frozen=True, eq=False)
class SetupStatistics:
    """Statistics over random feasible setups.

    Attributes:
        setups: m setups, each with at least one feasible direction at every position.
        drawn: number of draws that it took.
        positions: number of positions per setup.
        one_way: (m,) number of positions with exactly one feasible direction.
        switches: by measure (``MEASURES``), how often (m,) the better direction changes round the circle.
        wrong: by measure, at how many (m,) of the ``one_way`` positions the infeasible direction was chosen.
        points: by measure, Table I (m, 2, 3).
    """

    setups: tuple[SutureSetup, ...]
    drawn: int
    positions: int
    one_way: NDArray[np.intp]
    switches: dict[str, NDArray[np.intp]]
    wrong: dict[str, NDArray[np.intp]]
    points: dict[str, NDArray[np.float64]]

    def two_switches(self, measure: str, kept: bool = False) -> float:
        """Return the share of setups with exactly two changes of direction.

        Args:
            measure: name in ``MEASURES``.
            kept: count only setups where the measure never chooses the infeasible direction; NaN without any.
        """
        counts = self.switches[measure]
        counts = counts[self.wrong[measure] == 0] if kept else counts
        return float((counts == 2).mean()) if len(counts) else float("nan")

    def wrong_share(self, measure: str) -> float:
        """Return the share of ``one_way`` positions where the infeasible direction was chosen; NaN without any."""
        total = int(self.one_way.sum())
        return float(self.wrong[measure].sum() / total) if total else float("nan")

    def percentiles(self, measure: str) -> NDArray[np.float64]:
        """Return the 10th, 50th and 90th percentile (3, 2, 3) of the entries of Table I."""
        return np.percentile(self.points[measure], [10, 50, 90], axis=0)

    def paper_ranks(self, measure: str) -> NDArray[np.float64]:
        """Return the share (2, 3) of setups whose entry in Table I is below the paper's."""
        return (self.points[measure] < PAPER_TABLE_1).mean(0)

    def nearest_points(self, measure: str) -> float:
        """Return the largest difference from the paper's Table I, in points, of the setup that comes nearest."""
        return float(np.abs(self.points[measure] - PAPER_TABLE_1).max((1, 2)).min())

    def summary(self) -> dict[str, Any]:
        """Return everything except the setups as plain values."""
        return {
            "setups": len(self.setups),
            "drawn": self.drawn,
            "positions": self.positions,
            "feasible_means": "at least one direction is feasible at every position",
            "one_way_positions": int(self.one_way.sum()),
            "measures": {name: self._measure(name) for name in self.switches},
        }

    def _measure(self, name: str) -> dict[str, Any]:
        percentiles, ranks = self.percentiles(name), self.paper_ranks(name)
        cells = [(i, j) for i in range(2) for j in range(3)][:-1]  # the last entry is 100 by definition
        return {
            "two_switches": self.two_switches(name),
            "two_switches_where_no_choice_is_wrong": self.two_switches(name, kept=True),
            "setups_where_no_choice_is_wrong": int((self.wrong[name] == 0).sum()),
            "wrong_choice_share": self.wrong_share(name),
            "table_1": {
                f"{LOCATIONS[i]} location, {ALLOWED[j]} direction": {
                    "p10": float(percentiles[0, i, j]),
                    "p50": float(percentiles[1, i, j]),
                    "p90": float(percentiles[2, i, j]),
                    "paper": float(PAPER_TABLE_1[i, j]),
                    "share_below_paper": float(ranks[i, j]),
                }
                for i, j in cells
            },
            "paper_entries_within_p10_p90": sum(bool(0.1 <= ranks[cell] <= 0.9) for cell in cells),
            "nearest_setup_off_paper_points": self.nearest_points(name),
        }


def random_statistics(
    rng: np.random.Generator,
    count: int = 300,
    positions: int = 180,
    holdable: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SetupStatistics:
    """Return statistics over ``count`` random feasible setups.

    Args:
        rng: random generator.
        count: number of setups.
        positions: number of positions per setup, a multiple of 12.
        holdable: as in ``random_setup``.
        progress: called with the numbers of setups found and wanted.
    """
    if count < 1 or positions < COARSE or positions % COARSE:
        raise TrocarError(
            f"statistics over {count} setups at {positions} positions cannot be made; give at least one setup and "
            f"a multiple of {COARSE} positions"
        )
    thetas = np.arange(positions) * (TURN / positions)
    setups: list[SutureSetup] = []
    rows: list[dict[str, DexterityMap]] = []
    drawn = 0
    while len(setups) < count:
        if drawn == DRAWS_PER_SETUP * count:
            raise TrocarError(f"only {len(setups)} of {drawn} random setups are feasible; {count} were asked for")
        drawn += 1
        setup = random_setup(rng, holdable)
        if not reaches_everywhere(suture_joints(setup, thetas[:: positions // COARSE])):
            continue
        joints = suture_joints(setup, thetas)
        if not reaches_everywhere(joints):
            continue
        setups.append(setup)
        rows.append({name: scored(setup, reward, joints) for name, reward in MEASURES.items()})
        if progress:
            progress(len(setups), count)
    one_way = [row["default"].joints.feasible.sum(0) == 1 for row in rows]
    return SetupStatistics(
        tuple(setups),
        drawn,
        positions,
        np.array([where.sum() for where in one_way]),
        {name: np.array([len(row[name].switches_rad) for row in rows]) for name in MEASURES},
        {
            name: np.array([(~row[name].feasible & where).sum() for row, where in zip(rows, one_way, strict=True)])
            for name in MEASURES
        },
        {name: np.array([table_1(row[name]).points for row in rows]) for name in MEASURES},
    )
