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
from trocar.geometry import TURN, shown
from trocar.tasks.suture.planning.grid import plan_even
from trocar.tasks.suture.planning.parameters import SEARCHED, parameters_of, shown_parameter, with_parameters
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.primitive import jaws_above_m, suture_joints, sutures_at
from trocar.tasks.suture.planning.rewards import DexterityMap, scored
from trocar.tasks.suture.planning.setup import HOLDABLE_RAD, SutureSetup
from trocar.tasks.suture.planning.summary import crossing_sutures, mesh_left_m, relative_excess

CERTIFIED = "each setup's plan is the best on its grid; the setup is the best one found, which proves nothing"

GROUPS = {
    "circle": ("center_x_m", "center_y_m", "circle_radius_m"),
    "port": ("base_azimuth_rad", "base_sideways_m", "base_up_m", "base_tilt_rad", "base_spin_rad"),
    "grasp": ("grasp_behind_tip_rad", "grasp_approach_rad", "grasp_lean_rad"),
    "puller": ("puller_azimuth_rad", "puller_sideways_m", "puller_up_m"),
}
"""Parameters that are searched over together, by name."""
USUAL = ("circle", "port", "grasp")
"""The groups that are searched over by default."""
POPULATION = 48
COARSE = 72
"""During the search the grid is thinned, but to no fewer positions than this."""
INFEASIBLE_COST, CROSSING_COST = 10.0, 5.0
"""Added to the cost of an infeasible plan, and of one whose sutures cross: more than any reward."""


@dataclass(frozen=True, eq=False)
class FoundSetup:
    """Result of a search over setups.

    Attributes:
        start: the best plan of the initial setup.
        best: map of the best setup found, scaled like the map that the search started from.
        plan: the best plan there.
        sound: whether it can be recommended: the plan is feasible, flat jaws can hold the needle above the tissue, the
            needle comes out, bites hold the mesh, and no sutures cross.
        values: values of the free parameters.
        bounds: bounds of the free parameters.
        evaluations: number of setups evaluated.
    """

    start: SuturePlan
    best: DexterityMap
    plan: SuturePlan
    sound: bool
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

    Setups are preferred in which flat jaws can hold the needle, the instrument stays above the tissue, and the bites
    hold the mesh and do not cross. Without a body wall, only the bounds keep arm and port clear of the patient. Margin
    and manipulability are scaled alike in all setups, so that rewards are comparable.

    Args:
        start: gives reward, scales and grid, of which about ``COARSE`` positions are used during the search.
        free: names of the free parameters, from ``SEARCHED``.
        rng: random generator of the evolution.
        setup: the initial setup, whose other parameters stay; default: that of ``start``.
        bounds: of free parameters, in place of the usual ones.
        planner: makes the best plan of a map.
        evaluations: approximate number of setups to evaluate.
        progress: called with the number of setups evaluated and the number planned.

    Raises:
        InvalidInput: a parameter, its bounds, the grasp, the grid or the number of evaluations does not allow a search.
    """
    here = setup or start.setup
    limits = free_bounds(here, free, bounds)
    size = len(start.thetas_rad)
    stride = max(1, size // COARSE)
    planner(start)  # raises for wrong settings, before a search of minutes
    if evaluations < 2 * POPULATION:
        raise InvalidValue("the number of evaluations", evaluations, f"give at least {2 * POPULATION}")
    if size % stride:
        grid = f"a grid of {size} positions"
        raise InvalidInput(grid, f"does not contain every {stride}th of them", f"give a multiple of {COARSE}")
    if not here.grasp.holdable and not {"grasp_lean_rad", "grasp_skew_rad"} & set(free):
        raise InvalidInput(
            "the grasp",
            f"holds the wire {shown(here.grasp.out_of_jaws_rad, 'rad', '.0f')} out of the plane of flat jaws",
            "free the grasp's lean or skew, or start from skew 0",
        )
    thetas = start.thetas_rad[::stride]
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
        except InvalidInput:  # such as a needle that is too large for the circle, or a grasp beyond its tail
            return 4 * INFEASIBLE_COST
        return _cost(there, start, thetas, planner)

    first = rng.uniform(*limits_at.T, size=(POPULATION, len(free)))
    first[0] = np.clip(list(usual.values()), *limits_at.T)
    options: dict[str, Any] = {"init": first, "polish": False, "tol": 0.0}
    generations = max(1, evaluations // POPULATION - 1)
    x = differential_evolution(cost, limits_at.tolist(), maxiter=generations, rng=rng, **options).x
    values = dict(zip(free, x.tolist(), strict=True))
    best = _scaled_like(start, with_parameters(here, values), start.thetas_rad)
    here_cost, best_cost = (_cost(one, start, start.thetas_rad, planner) for one in (here, best.setup))
    unchanged = _scaled_like(start, here, start.thetas_rad)
    if best_cost > here_cost:
        best, values, best_cost = unchanged, usual, here_cost
    plan = planner(best)
    sound = plan.feasible and best_cost < CROSSING_COST
    return FoundSetup(planner(unchanged), best, plan, sound, values, limits, evaluated)


def _scaled_like(start: DexterityMap, setup: SutureSetup, thetas_rad: NDArray[np.float64]) -> DexterityMap:
    return scored(setup, start.reward, suture_joints(setup, thetas_rad), scales=start.scales)


def _cost(setup: SutureSetup, start: DexterityMap, thetas_rad: NDArray[np.float64], planner: Planner) -> float:
    """Return minus the reward of a setup's best plan, or a penalty if the plan is not sound.

    Penalties grow with what is wrong, to lead the evolution out, in ranges that do not overlap. From worst to best:
    jaws in the tissue or a grasp that flat jaws cannot hold; bites that do not come out or do not hold the mesh; a plan
    out of reach; sutures that cross.
    """
    if unsound := _cost_of_grasp_and_bite(setup):
        return unsound
    found = _scaled_like(start, setup, thetas_rad)
    plan = planner(found)
    if start.reward.feasible_first and not plan.feasible:
        outside = relative_excess(found.joints).max(-1)
        return INFEASIBLE_COST + min(float(outside.min(0).max()), INFEASIBLE_COST)
    if pairs := crossing_sutures(sutures_at(setup, plan.positions_rad, plan.directions)):
        share = len(pairs) / math.comb(len(plan.positions_rad), 2)
        return CROSSING_COST + share + setup.bite_m / setup.circle.radius_m
    return -plan.reward


def _cost_of_grasp_and_bite(setup: SutureSetup) -> float:
    """Return the penalty for grasp and bite, which are the same at every position; 0 if both are sound."""
    if (height_m := jaws_above_m(setup)) < 0:
        return 3 * INFEASIBLE_COST + 1 - height_m
    if not setup.grasp.holdable:
        return 3 * INFEASIBLE_COST + setup.grasp.out_of_jaws_rad - HOLDABLE_RAD
    if not setup.comes_out:
        missing_rad = setup.exit_turn_rad - setup.insertion.turn_rad
        return 2 * INFEASIBLE_COST + (TURN if math.isnan(missing_rad) else missing_rad)
    if (over_m := setup.circle.mesh_margin_m - mesh_left_m(setup)) > 0:
        return 2 * INFEASIBLE_COST + over_m
    return 0.0


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
        if part in ("base", "center"):
            with_parameters(setup, {name: end})
        else:  # check the part alone: other free parameters may make the whole setup valid
            replace(getattr(setup, part), **{number: end})
