"""Search for the circle, port and grasp whose best plan of sutures scores highest: an outer loop round the planner.

For each setup the plan is the best on its grid. Over setups the search is differential evolution, which proves nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import shown
from trocar.tasks.suture.planning.grid import plan_even
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.primitive import jaws_above_m, suture_joints
from trocar.tasks.suture.planning.rewards import DexterityMap, scored
from trocar.tasks.suture.planning.setup import (
    HOLDABLE_RAD,
    SEARCHED,
    SutureSetup,
    parameters_of,
    shown_parameter,
    with_parameters,
)

CERTIFIED = "each setup's plan is the best on its grid; the setup is the best one found, which proves nothing"

GROUPS = {
    "circle": ("center_x_m", "center_y_m", "circle_radius_m"),
    "port": ("base_azimuth_rad", "base_sideways_m", "base_up_m", "base_tilt_rad", "base_spin_rad"),
    "grasp": ("grasp_behind_tip_rad", "grasp_approach_rad", "grasp_lean_rad"),
}
"""Parameters that are searched over together, by name."""
POPULATION = 48
COARSE = 72
"""Size of the grid during the search."""
INFEASIBLE_COST = 10.0
"""Added to the cost of an infeasible plan: more than any reward."""
MAX_SHIFT_M = 0.5
"""Largest shift of the circle's centre along an axis."""


@dataclass(frozen=True, eq=False)
class FoundSetup:
    """Result of a search over setups.

    Attributes:
        start: the best plan of the initial setup.
        best: map of the best setup found, scaled like the map that the search started from.
        plan: the best plan there.
        values: of the free parameters.
        bounds: of the free parameters.
        evaluations: number of setups evaluated.
    """

    start: SuturePlan
    best: DexterityMap
    plan: SuturePlan
    values: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    evaluations: int


def search_setup(
    start: DexterityMap,
    free: Sequence[str],
    *,
    rng: np.random.Generator,
    setup: SutureSetup | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    planner: Planner = plan_even,
    evaluations: int = 3000,
    progress: Callable[[int, int], None] | None = None,
) -> FoundSetup:
    """Return the best setup found over some of its parameters; never worse than the initial one.

    Flat jaws can hold the needle as it is grasped, and stay above the tissue; otherwise only the bounds keep arm and
    port clear of the patient. Margin and manipulability are scaled alike in all setups; with a scale of its own for
    each, rewards would not be comparable.

    Args:
        start: gives reward, scales and grid, whose size is a multiple of ``COARSE``.
        free: names of the free parameters, from ``SEARCHED``.
        rng: random generator of the evolution.
        setup: the initial setup, whose other parameters stay; default: that of ``start``.
        bounds: of free parameters, in place of the usual ones.
        planner: makes the best plan of a map.
        evaluations: approximate number of setups to evaluate.
        progress: called with the number of setups evaluated and the number planned.
    """
    here = setup or start.setup
    limits = free_bounds(here, free, bounds)
    planner(start)  # what is wrong with its settings is told before a search of minutes
    if evaluations < 2 * POPULATION:
        raise InvalidValue("the number of evaluations", evaluations, f"give at least {2 * POPULATION}")
    if (size := len(start.thetas_rad)) % COARSE:
        grid = f"a grid of {size} positions"
        raise InvalidInput(grid, f"does not contain the search's of {COARSE}", f"give a multiple of {COARSE}")
    if not here.grasp.holdable and not {"grasp_lean_rad", "grasp_skew_rad"} & set(free):
        raise InvalidInput(
            "the grasp",
            f"holds the wire {shown(here.grasp.out_of_jaws_rad, 'rad', '.0f')} out of the plane of flat jaws",
            "free the grasp's lean or skew, or start from skew 0",
        )
    thetas = start.thetas_rad[:: size // COARSE]
    limits_at = np.array(list(limits.values()))
    usual = {name: parameters_of(here)[name] for name in free}
    evaluated = 0

    def cost(x: NDArray[np.float64]) -> float:
        nonlocal evaluated
        evaluated += 1
        if progress and evaluated % POPULATION == 0:
            progress(min(evaluated, evaluations), evaluations)
        try:
            there = with_parameters(here, dict(zip(free, x.tolist(), strict=True)))
        except InvalidInput:  # a needle larger than the circle allows, a grasp beyond its tail
            return 4 * INFEASIBLE_COST
        return _cost(there, start, thetas, planner)

    first = rng.uniform(*limits_at.T, size=(POPULATION, len(free)))
    first[0] = np.clip(list(usual.values()), *limits_at.T)
    options: dict[str, Any] = {"init": first, "polish": False, "tol": 0.0}
    generations = max(1, evaluations // POPULATION - 1)
    x = differential_evolution(cost, limits_at.tolist(), maxiter=generations, rng=rng, **options).x
    values = dict(zip(free, x.tolist(), strict=True))
    best = _scaled_like(start, with_parameters(here, values), start.thetas_rad)
    plan, unchanged = planner(best), _scaled_like(start, here, start.thetas_rad)
    start_plan = planner(unchanged)
    worse = (plan.feasible, plan.reward) < (start_plan.feasible, start_plan.reward)
    if worse or jaws_above_m(best.setup) < 0 or not best.setup.grasp.holdable:
        best, plan, values = unchanged, start_plan, usual
    return FoundSetup(start_plan, best, plan, values, limits, evaluated)


def _scaled_like(start: DexterityMap, setup: SutureSetup, thetas_rad: NDArray[np.float64]) -> DexterityMap:
    return scored(setup, start.reward, suture_joints(setup, thetas_rad), scales=start.scales)


def _cost(setup: SutureSetup, start: DexterityMap, thetas_rad: NDArray[np.float64], planner: Planner) -> float:
    """Return minus the reward of a setup's best plan.

    Setups without a feasible one cost more the worse they are, in ranks that do not overlap, so that the evolution is
    led out of them: jaws in the tissue or unholdable grasp, plan out of reach, feasible plan.
    """
    if (height_m := jaws_above_m(setup)) < 0:
        return 3 * INFEASIBLE_COST + 1 - height_m
    if not setup.grasp.holdable:
        return 3 * INFEASIBLE_COST + setup.grasp.out_of_jaws_rad - HOLDABLE_RAD
    found = _scaled_like(start, setup, thetas_rad)
    plan = planner(found)
    if plan.feasible or not start.reward.feasible_first:
        return -plan.reward
    outside = found.joints.excess.sum(-1) + found.joints.too_shallow_m
    return INFEASIBLE_COST + min(float(outside.min(0).max()), INFEASIBLE_COST)


def free_bounds(
    setup: SutureSetup, free: Sequence[str], bounds: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, tuple[float, float]]:
    """Return the bounds of these parameters, or raise InvalidInput."""
    if not free or len(set(free)) != len(free):
        choices = f"name one or more of {', '.join(SEARCHED)}, each once"
        raise InvalidInput("the free parameters", f"are {', '.join(free) or 'none'}", choices)
    for name in free:
        if name not in SEARCHED:
            raise UnknownName("the parameter to search over", name, SEARCHED)
    given = dict(bounds or {})
    if strange := [name for name in given if name not in free]:
        name = shown_parameter(strange[0])[1]
        raise InvalidInput(f"the parameter {name!r}", "has bounds but is not free", "free it or drop its bounds")
    for name, ends in given.items():
        _check_bounds(setup, name, *ends)
    return {name: given.get(name, SEARCHED[name]) for name in free}


def _check_bounds(setup: SutureSetup, name: str, low: float, high: float) -> None:
    """Raise InvalidInput unless a parameter of this setup can be searched between these bounds."""
    scale, said = shown_parameter(name)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        bounds = f"is bounded by {scale * low:g} and {scale * high:g}"
        raise InvalidInput(said, bounds, "give two finite numbers, the lower first")
    part, number = name.split("_", 1)
    for end in (low, high):
        if part == "base":
            with_parameters(setup, {name: end})
        elif part != "center":  # the part alone: with other free parameters, a setup may hold it
            replace(getattr(setup, part), **{number: end})
        elif abs(end) > MAX_SHIFT_M:
            limits = f"give {shown(-MAX_SHIFT_M, 'm', 'g')} to {shown(MAX_SHIFT_M, 'm', 'g')}"
            raise InvalidValue("the shift of the circle's centre", shown(end, "m", "g"), limits)
