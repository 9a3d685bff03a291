"""Setups that reproduce the paper's Table I with each margin formula: the table determines neither setup nor formula.

They differ in base, needle, grasp and formula; all come within a few points of every entry, keep all joints within
their limits and switch directions twice, as far apart as in the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, minimize

from trocar.errors import TrocarError
from trocar.geometry import TURN
from trocar.tasks.suture.planning.joints import suture_joints
from trocar.tasks.suture.planning.parameters import RANGES, parameters_of, with_parameters
from trocar.tasks.suture.planning.random_setups import MEASURES
from trocar.tasks.suture.planning.rewards import MARGINS, DexterityMap, dexterity, scored
from trocar.tasks.suture.planning.setup import SutureSetup
from trocar.tasks.suture.planning.study import PAPER_SWITCHES_DEG, Table1, switches_off_deg, table_1

FREE = tuple(name for name in RANGES if not name.startswith(("center", "base_azimuth")))
"""Fitted parameters; the azimuth does not affect the table, and follows from where the directions switch."""

FITTED: dict[str, tuple[float, ...]] = {
    "smallest": (3.6477, 0.0227, 0.0376, 0.1481, -0.1572, -1.4831, 0.0065, 2.4355, -0.7181, 0.8216, 0.9590),
    "normalised": (1.5184, 0.0329, 0.0414, 0.1167, -0.1988, -1.2416, 0.0096, 2.3678, -0.6288, 0.5911, 0.1308),
    "clipped": (1.8500, 0.0334, 0.0481, 0.1172, 1.0391, -0.6890, 0.0085, 1.6634, -2.9460, 1.4675, 2.2215),
    "paper": (2.0769, 0.0363, 0.0493, 0.1049, 0.8696, -0.6994, 0.0078, 1.6457, -0.4171, 1.3617, -1.4717),
}
"""Rounded results of ``fit_table_1`` with seed 0, by formula: azimuth of the base, then ``FREE``; m and rad."""

COARSE = 120
GENERATIONS = 70


@dataclass(frozen=True, eq=False)
class TableFit:
    """One setup fitted to the table.

    Attributes:
        margin: name of the formula.
        setup: the geometry.
        dexterity: its map by that formula.
        table: its Table I.
    """

    margin: str
    setup: SutureSetup
    dexterity: DexterityMap
    table: Table1

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        switches = np.degrees(self.dexterity.switches_rad)
        return {
            "margin": self.margin,
            "parameters": parameters_of(self.setup),
            "points": self.table.points.tolist(),
            "largest_difference_points": float(np.abs(self.table.off_paper).max()),
            "switches_deg": switches.tolist(),
            "switches_off_paper_deg": switches_off_deg(switches),
            "infeasible_positions": int((~self.dexterity.feasible).sum()),
        }


def table_fits() -> list[TableFit]:
    """Return a fitted setup for each margin formula, with its Table I."""
    return [_fit(margin, with_parameters(SutureSetup(), _named(FITTED[margin]))) for margin in MARGINS]


def fit_table_1(
    margin: str, seed: int = 0, generations: int = GENERATIONS, progress: Callable[[int, int], None] | None = None
) -> TableFit:
    """Return a setup that reproduces Table I with this formula; takes about a minute.

    Args:
        margin: name in ``MARGINS``.
        seed: of the search (differential evolution, then a simplex).
        generations: number of generations of the evolution.
        progress: called with the numbers of finished and of all generations.
    """
    if margin not in MARGINS:
        raise TrocarError(f"the margin {margin!r} is unknown; choose one of {', '.join(MARGINS)}")
    low, high = np.array([(RANGES[name].low, RANGES[name].high) for name in FREE]).T
    thetas = np.arange(COARSE) * (TURN / COARSE)
    done = 0

    def misfit(x: NDArray[np.float64]) -> float:
        if (x < low).any() or (x > high).any():
            return 1e3
        setup = with_parameters(SutureSetup(), dict(zip(FREE, x, strict=True)))
        found = scored(setup, MEASURES[margin], suture_joints(setup, thetas))
        infeasible = float((~found.feasible).mean())
        switches = np.degrees(found.switches_rad)
        if infeasible or len(switches) != 2:
            return 200 + 100 * infeasible + len(switches)
        apart = PAPER_SWITCHES_DEG[1] - PAPER_SWITCHES_DEG[0]
        off = min(abs(switches[1] - switches[0] - arc) for arc in (apart, 360 - apart))
        return float(np.abs(table_1(found).off_paper).max()) + max(0.0, off - 6.0)  # two steps of the coarse grid

    def count(_x: object, convergence: float = 0.0) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, generations)

    bounds = list(zip(low, high, strict=True))
    evolved = differential_evolution(
        misfit, bounds, popsize=8, maxiter=generations, rng=seed, polish=False, init="sobol", callback=count
    )
    simplex = evolved.x + np.vstack([np.zeros(len(FREE)), np.diag(0.03 * (high - low))])
    options = {"maxfev": 1500 * generations // GENERATIONS, "initial_simplex": simplex}
    x = minimize(misfit, evolved.x, method="Nelder-Mead", options=options).x
    setup = with_parameters(SutureSetup(), dict(zip(FREE, x, strict=True)))
    return _fit(margin, _facing_the_switches(setup, margin))


def _facing_the_switches(setup: SutureSetup, margin: str) -> SutureSetup:
    """Return the setup rotated about the circle's axis so that directions switch nearest to where the paper's do."""
    switches = np.degrees(dexterity(setup, MEASURES[margin]).switches_rad)
    turns = np.arange(360.0)
    off = [max(switches_off_deg(switches + turn)) for turn in turns]
    azimuth = parameters_of(setup)["base_azimuth_rad"] + np.radians(turns[int(np.argmin(off))])
    return with_parameters(setup, {"base_azimuth_rad": azimuth})


def _named(numbers: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(("base_azimuth_rad", *FREE), numbers, strict=True))


def _fit(margin: str, setup: SutureSetup) -> TableFit:
    found = dexterity(setup, MEASURES[margin])
    return TableFit(margin, setup, found, table_1(found))
