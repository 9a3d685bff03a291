"""Search for the circle, port and grasp whose best plan of sutures scores highest: an outer loop round the planner.

For each setup the plan is exact (on its grid). Over setups the search is differential evolution, which proves nothing.
For up to three parameters that only move or resize the circle, ``outer_bound.py`` proves how much better it could get.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from trocar.errors import TrocarError
from trocar.geometry import shown
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.joints import suture_joints
from trocar.tasks.suture.planning.parameters import (
    RANGES,
    check_bounds,
    check_names,
    parameters_of,
    shown_parameter,
    with_parameters,
)
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.primitive import places, tip_poses
from trocar.tasks.suture.planning.rewards import DexterityMap, Reward, Scales, dexterity, scored
from trocar.tasks.suture.planning.setup import HOLDABLE_RAD, SutureSetup

HEURISTIC = "inner exact, outer heuristic: each setup's plan is the best on its grid; the setup is the best one found"

PLACEMENT = ("center_x_m", "center_y_m", "circle_radius_m")
PORT = ("base_azimuth_rad", "base_sideways_m", "base_up_m", "base_tilt_rad", "base_spin_rad")
GRASP = ("grasp_behind_tip_rad", "grasp_approach_rad", "grasp_lean_rad")

POPULATION = 48
INFEASIBLE_COST = 10.0
"""Added to the cost of an infeasible plan: more than any reward."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class OuterSearch:
    """Result of a search over setups.

    Attributes:
        start: map of the initial setup.
        start_plan: the best plan there.
        best: map of the best setup found, scaled like ``start``, so that rewards are comparable.
        plan: the best plan there.
        free: names of the parameters that were searched over.
        bounds: (f, 2) their bounds.
        evaluations: number of setups evaluated.
        seconds: duration of the search.
        certified: what is proven and what is not, in words.
    """

    start: DexterityMap
    start_plan: SuturePlan
    best: DexterityMap
    plan: SuturePlan
    free: tuple[str, ...]
    bounds: NDArray[np.float64]
    evaluations: int
    seconds: float
    certified: str

    @property
    def setups_per_s(self) -> float:
        """Return the number of setups evaluated per second, planner included."""
        return self.evaluations / self.seconds

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        was, is_now = parameters_of(self.start.setup), _chosen(self.start.setup, self.best.setup)
        return {
            "free": {
                name: {"from": was[name], "to": is_now[name], "low": low, "high": high}
                for name, (low, high) in zip(self.free, self.bounds.tolist(), strict=True)
            },
            "start_reward": self.start_plan.reward,
            "start_feasible": self.start_plan.feasible,
            "reward": self.plan.reward,
            "feasible": self.plan.feasible,
            "positions_deg": np.degrees(self.plan.positions_rad).tolist(),
            "directions": self.plan.directions.tolist(),
            "holdable": self.best.setup.grasp.holdable,
            "evaluations": self.evaluations,
            "seconds": self.seconds,
            "setups_per_s": self.setups_per_s,
            "certified": self.certified,
        }


def _chosen(start: SutureSetup, best: SutureSetup) -> dict[str, float]:
    """Return the parameters of the best setup, with the base measured from the initial circle."""
    from_start = replace(best, circle=replace(best.circle, T_world_circle=start.circle.T_world_circle))
    shift = (start.circle.T_world_circle.inverse() @ best.circle.T_world_circle).translation_m
    return {**parameters_of(from_start), "center_x_m": float(shift[0]), "center_y_m": float(shift[1])}


def outer_search(
    setup: SutureSetup,
    reward: Reward | None = None,
    free: Sequence[str] = (*PLACEMENT, *PORT, *GRASP),
    *,
    rng: np.random.Generator,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    planner: Planner = plan_even,
    positions: int = 360,
    coarse: int = 72,
    evaluations: int = 3000,
    holdable: bool = True,
    scales: Scales | None = None,
    progress: Progress | None = None,
) -> OuterSearch:
    """Return the best setup found over some of its parameters; never worse than the initial one.

    The jaws stay above the tissue; otherwise only the bounds keep arm and port clear of the patient. Margin and
    manipulability are scaled alike in all setups; with a scale of its own for each, rewards would not be comparable.

    Args:
        setup: the initial setup; parameters that are not free stay.
        reward: how sutures are scored.
        free: names of the free parameters, from ``RANGES``.
        rng: random generator of the evolution.
        bounds: of free parameters, in place of ``RANGES``.
        planner: makes the best plan of a map.
        positions: size of the grid of the returned plans; a multiple of ``coarse``.
        coarse: size of the grid during the search.
        evaluations: approximate number of setups to evaluate.
        holdable: whether flat jaws must be able to hold the needle as grasped.
        scales: of margin and manipulability; default: those of the initial setup.
        progress: called with the number of setups evaluated and the number planned.
    """
    start = dexterity(setup, reward, positions)
    if scales is not None:
        start = scored(setup, start.reward, start.joints, scales=scales)
    limits = free_bounds(free, bounds)
    if evaluations < 2 * POPULATION:
        raise TrocarError(f"the number of evaluations is {evaluations}; give at least {2 * POPULATION}")
    if positions % coarse:
        raise TrocarError(
            f"a grid of {positions} positions does not contain the search's of {coarse}; give a multiple of {coarse}"
        )
    if holdable and not setup.grasp.holdable and not {"grasp_lean_rad", "grasp_skew_rad"} & set(free):
        raise TrocarError(
            f"the grasp holds the wire {shown(setup.grasp.out_of_jaws_rad, 'rad', '.0f')} out of the plane of flat "
            "jaws; free the grasp's lean or skew, start from skew 0, or allow grasps that flat jaws cannot hold"
        )
    thetas = start.thetas_rad[:: positions // coarse]
    evaluated = 0

    # Infeasible setups cost more the worse they are, in ranks that do not overlap, so that the evolution is led out of
    # them: no setup at all, jaws in the tissue or unholdable grasp, plan out of reach, feasible plan.
    def cost(x: NDArray[np.float64]) -> float:
        nonlocal evaluated
        evaluated += 1
        if progress and evaluated % POPULATION == 0:
            progress(min(evaluated, evaluations), evaluations)
        try:
            there = with_parameters(setup, dict(zip(free, x.tolist(), strict=True)))
        except TrocarError:  # a needle larger than the circle allows, a grasp beyond its tail
            return 4 * INFEASIBLE_COST
        if (height := jaws_above_m(there)) < 0:
            return 3 * INFEASIBLE_COST + 1 - height
        if holdable and not there.grasp.holdable:
            return 3 * INFEASIBLE_COST + there.grasp.out_of_jaws_rad - HOLDABLE_RAD
        return plan_cost(there, start.reward, thetas, start.scales, planner)

    began = time.perf_counter()
    generations = max(1, evaluations // POPULATION - 1)
    first = rng.uniform(*limits.T, size=(POPULATION, len(free)))
    here = parameters_of(setup)
    first[0] = np.clip([here[name] for name in free], *limits.T)
    options: dict[str, Any] = {"init": first, "polish": False, "tol": 0.0}
    x = differential_evolution(cost, limits.tolist(), maxiter=generations, rng=rng, **options).x
    seconds = time.perf_counter() - began
    usual = planner(start)
    found = with_parameters(setup, dict(zip(free, x.tolist(), strict=True)))
    best = scored(found, start.reward, suture_joints(found, start.thetas_rad), scales=start.scales)
    plan = planner(best)
    allowed = jaws_above_m(found) >= 0 and (found.grasp.holdable or not holdable)
    if not allowed or (plan.feasible, plan.reward) < (usual.feasible, usual.reward):
        best, plan = start, usual
    return OuterSearch(start, usual, best, plan, tuple(free), limits, evaluated, seconds, HEURISTIC)


def plan_cost(
    setup: SutureSetup, reward: Reward, thetas_rad: NDArray[np.float64], scales: Scales, planner: Planner
) -> float:
    """Return minus the reward of a setup's best plan or, if that is infeasible, a cost that grows with the excess."""
    found = scored(setup, reward, suture_joints(setup, thetas_rad), scales=scales)
    plan = planner(found)
    if plan.feasible or not reward.feasible_first:
        return -plan.reward
    outside = found.joints.excess.sum(-1) + found.joints.too_shallow_m
    return INFEASIBLE_COST + min(float(outside.min(0).max()), INFEASIBLE_COST)


def jaws_above_m(setup: SutureSetup) -> float:
    """Return the smallest height above the tissue's plane of the jaws, from the held point back to their joint."""
    along = places(setup)
    T_circle_tip = tip_poses(setup, along.advance_m, along.jaws_rad).matrix
    held = T_circle_tip[..., 2, 3]
    return float(np.minimum(held, held + setup.arm.tip_length_m * T_circle_tip[..., 2, 2]).min())


def free_bounds(free: Sequence[str], bounds: Mapping[str, tuple[float, float]] | None = None) -> NDArray[np.float64]:
    """Return the bounds (f, 2) of these parameters, or raise TrocarError."""
    if not free or len(set(free)) != len(free):
        raise TrocarError(
            f"the free parameters are {', '.join(free) or 'none'}; name one or more of {', '.join(RANGES)}, each once"
        )
    check_names(tuple(free))
    given = dict(bounds or {})
    if strange := [name for name in given if name not in free]:
        name = shown_parameter(strange[0])[1]
        raise TrocarError(f"bounds are given for {name!r}, which is not free; free it or drop its bounds")
    limits = np.array([given.get(name, (RANGES[name].low, RANGES[name].high)) for name in free], dtype=np.float64)
    for name, (low, high) in zip(free, limits, strict=True):
        check_bounds(name, low, high)
    return limits
