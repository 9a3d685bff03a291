"""Sensitivity of plans to errors of joints and circle, and the plan with the best worst case.

A scenario is one pair of errors. The joint error is the residual of the cable model in roll, wrist pitch and wrist yaw:
along all sutures the joints are off by this amount, and thus nearer to a limit or farther from it. The circle error is
a rigid motion of the tissue: the positions are marked on the tissue, and the arm sutures where it finds them. Errors
that change from suture to suture are not modelled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from trocar.errors import TrocarError
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning.even import plan_even
from trocar.tasks.suture.planning.joints import SutureJoints, suture_joints
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.rewards import DexterityMap, scored
from trocar.tasks.suture.planning.setup import DIRECTIONS

CABLES_RAD = (0.007, 0.020, 0.014)
"""Residual RMSE of q4 q5 q6 after calibration: ``play`` on the last fifth of ``psm1_grey_random``
(``trocar study calibration``; the joints of ``trocar.calibration.plant.PSM1_GREY``)."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of a scenario's errors, which are normal and independent.

    Attributes:
        joints_rad: of roll, wrist pitch and wrist yaw.
        translation_m: of the circle along each axis (assumed: a phantom registered by touch or camera).
        rotation_rad: of the circle about each axis (assumed).
    """

    joints_rad: tuple[float, float, float] = CABLES_RAD
    translation_m: float = 0.001
    rotation_rad: float = math.radians(1.0)

    def __post_init__(self) -> None:
        values = (*self.joints_rad, self.translation_m, self.rotation_rad)
        if len(values) != 5 or not all(math.isfinite(value) and 0 <= value <= 0.2 for value in values):
            raise TrocarError(
                f"the standard deviations are {self.joints_rad} rad of three wrist joints, {self.translation_m} m and "
                f"{self.rotation_rad} rad of the circle; give 0 to 0.2 for each"
            )


@dataclass(frozen=True, eq=False)
class Scenarios:
    """Possible errors; the first scenario has none.

    Attributes:
        joints_rad: (s, 3) added to roll, wrist pitch and wrist yaw.
        T_planned_circle: (s,) pose of the true circle in the planned one.
        about: how they were chosen, in words.
    """

    joints_rad: NDArray[np.float64]
    T_planned_circle: SE3
    about: str = "given"

    def __len__(self) -> int:
        return len(self.joints_rad)

    @staticmethod
    def draw(rng: np.random.Generator, count: int = 100, uncertainty: Uncertainty | None = None) -> Scenarios:
        """Return ``count`` scenarios, the first without error, the others random."""
        if not 1 <= count <= 10_000:
            raise TrocarError(f"the number of scenarios is {count}; give 1 to 10000")
        noise = rng.standard_normal((count, 9))
        noise[0] = 0.0
        return Scenarios._of(noise, uncertainty, "random")

    @staticmethod
    def corners(uncertainty: Uncertainty | None = None, deviations: float = 1.0) -> Scenarios:
        """Return the scenario without error and 32 corners of a box of errors, this many standard deviations away.

        Signs are balanced, and each corner comes with its opposite (a folded-over Hadamard matrix of order 16). A plan
        that is robust against the corners is also robust against random errors, whereas a plan made for random draws
        overfits the few largest of them.
        """
        if not (math.isfinite(deviations) and 0 <= deviations <= 5):
            raise TrocarError(f"the corners lie at {deviations:g} standard deviations; give 0 to 5")
        signs = deviations * hadamard(16)[:, 1:10]
        noise = np.vstack([np.zeros(9), signs, -signs])
        return Scenarios._of(noise, uncertainty, f"balanced corners at {deviations:g} standard deviations")

    @staticmethod
    def _of(noise: NDArray[np.float64], uncertainty: Uncertainty | None, about: str) -> Scenarios:
        """Return scenarios from errors (s, 9) in standard deviations: three joints, translation, rotation."""
        sd = uncertainty or Uncertainty()
        twists = noise[:, 3:] * np.repeat([sd.translation_m, sd.rotation_rad], 3)
        return Scenarios(noise[:, :3] * sd.joints_rad, SE3.exp(twists), about)


def maps(nominal: DexterityMap, scenarios: Scenarios) -> Iterator[DexterityMap]:
    """Yield the map of the sutures in each scenario, scaled as without errors."""
    setup = nominal.setup
    for error, T_planned_circle in zip(scenarios.joints_rad, scenarios.T_planned_circle.matrix, strict=True):
        circle = replace(setup.circle, T_world_circle=setup.circle.T_world_circle @ SE3.unchecked(T_planned_circle))
        there = replace(setup, circle=circle)
        joints = suture_joints(there, nominal.thetas_rad)
        joints = replace(joints, q=joints.q + np.concatenate([np.zeros(3), error]))
        yield scored(there, nominal.reward, joints, nominal.manipulability_at, nominal.source, nominal.scales)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Performance of one plan over scenarios.

    Attributes:
        plan: the plan.
        rewards: (s,) its true reward in each scenario, with its own directions.
        feasible: (s,) whether all of its sutures are feasible.
        best_rewards: (s,) reward of the plan that would have been made had the scenario been known.
        best_theta_rad: (s,) first suture of that plan.
    """

    plan: SuturePlan
    rewards: NDArray[np.float64]
    feasible: NDArray[np.bool_]
    best_rewards: NDArray[np.float64]
    best_theta_rad: NDArray[np.float64]

    @property
    def regret(self) -> NDArray[np.float64]:
        """Return the reward (s,) that knowing the scenario would have gained.

        Negative where this plan scores higher but is infeasible, and the reward puts feasibility first.
        """
        return self.best_rewards - self.rewards

    @property
    def shift_rad(self) -> NDArray[np.float64]:
        """Return how far (s,) the best evenly spaced plan moves; such plans repeat after one gap."""
        gap = TURN / len(self.plan.positions_rad)
        return np.abs((self.best_theta_rad - self.plan.positions_rad[0] + gap / 2) % gap - gap / 2)

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "scenarios": len(self.rewards),
            "planned_reward": self.plan.reward,
            "reward_worst_p5_p50": [float(self.rewards.min()), *np.percentile(self.rewards, [5, 50]).tolist()],
            "infeasible_share": float((~self.feasible).mean()),
            "regret_mean_p95_max": [float(self.regret.mean()), *np.percentile(self.regret, [95, 100]).tolist()],
            "best_plan_shift_p50_p95_deg": np.degrees(np.percentile(self.shift_rad, [50, 95])).tolist(),
        }


def sensitivity(
    nominal: DexterityMap,
    scenarios: Scenarios,
    planner: Planner = plan_even,
    progress: Progress | None = None,
    plan: SuturePlan | None = None,
) -> Sensitivity:
    """Return how a plan performs in these scenarios, compared with the best plan of each scenario.

    Args:
        nominal: map of the sutures without errors.
        scenarios: the errors; to assess a robust plan, take others than it was made for.
        planner: makes the best plan of a map.
        progress: called with the numbers of finished and of all scenarios.
        plan: the plan, on the map's grid; default: the best one without errors.
    """
    plan = plan or planner(nominal)
    choice, where = _on_grid(nominal, plan)
    rows = []
    for number, there in enumerate(maps(nominal, scenarios), start=1):
        best = planner(there)
        feasible = bool(there.joints.feasible[choice, where].all())
        rows.append((there.values[choice, where].min(), feasible, best.reward, best.positions_rad[0]))
        if progress:
            progress(number, len(scenarios))
    rewards, feasible, best_rewards, thetas = (np.array(column) for column in zip(*rows, strict=True))
    return Sensitivity(plan, rewards, feasible, best_rewards, thetas)


@dataclass(frozen=True, eq=False)
class RobustPlan:
    """The plan with the best worst case over scenarios, and the one made without errors.

    Attributes:
        plan: the robust plan; its ``rewards`` are those in the worst scenario of each suture, and ``feasible`` means
            feasible in every scenario.
        nominal: the plan made without errors; rewards as planned.
        nominal_worst: reward of the nominal plan in its worst scenario.
        nominal_feasible: whether the nominal plan is feasible in every scenario.
        planned_reward: reward of the robust plan without errors; below the nominal plan's by the price of robustness.
        scenarios: number of scenarios.
    """

    plan: SuturePlan
    nominal: SuturePlan
    nominal_worst: float
    nominal_feasible: bool
    planned_reward: float
    scenarios: int

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "scenarios": self.scenarios,
            "certified": self.plan.certified,
            "positions_deg": np.degrees(self.plan.positions_rad).tolist(),
            "directions": self.plan.directions.tolist(),
            "worst_reward": self.plan.reward,
            "planned_reward": self.planned_reward,
            "feasible_in_every_scenario": self.plan.feasible,
            "nominal_positions_deg": np.degrees(self.nominal.positions_rad).tolist(),
            "nominal_worst_reward": self.nominal_worst,
            "nominal_planned_reward": self.nominal.reward,
            "nominal_feasible_in_every_scenario": self.nominal_feasible,
        }


def worst_map(nominal: DexterityMap, scenarios: Scenarios, progress: Progress | None = None) -> DexterityMap:
    """Return the map that gives each suture its dexterity in the scenario that is worst for it.

    The worst case of a plan is that of its worst suture, so any planner makes the best robust plan from this map. Its
    joints hold the smallest and largest value of each joint over all scenarios.
    """
    values, margin, manipulability = nominal.values, nominal.margin, nominal.manipulability
    low, high = nominal.joints.q.min(2), nominal.joints.q.max(2)
    for number, there in enumerate(maps(nominal, scenarios), start=1):
        values, margin = np.minimum(values, there.values), np.minimum(margin, there.margin)
        manipulability = np.minimum(manipulability, there.manipulability)
        low, high = np.minimum(low, there.joints.q.min(2)), np.maximum(high, there.joints.q.max(2))
        if progress:
            progress(number, len(scenarios))
    ends = np.stack([low, high], axis=2)
    joints = SutureJoints(nominal.joints.arm, nominal.thetas_rad, ends, np.ones(2, dtype=bool))
    order = values - 1e9 * ~joints.feasible if nominal.reward.feasible_first else values
    choice = np.argmax(order, axis=0)
    return replace(nominal, joints=joints, margin=margin, manipulability=manipulability, values=values, choice=choice)


def plan_robust(
    nominal: DexterityMap,
    scenarios: Scenarios,
    planner: Planner = plan_even,
    progress: Progress | None = None,
) -> RobustPlan:
    """Return the plan with the best worst case over these scenarios: exact on the grid, for these scenarios only.

    Args:
        nominal: map of the sutures without errors.
        scenarios: the errors to withstand, such as ``Scenarios.corners()``.
        planner: makes the best plan of a map, such as ``plan_even`` or ``lambda map: plan_gaps(map, 6, spacing)``.
        progress: called with the numbers of finished and of all scenarios.
    """
    worst = worst_map(nominal, scenarios, progress)
    robust, usual = planner(worst), planner(nominal)
    said = (
        f"{robust.certified}, in the worst of {len(scenarios)} scenarios ({scenarios.about}); nothing is claimed for "
        "other errors"
    )
    usual_at, robust_at = _on_grid(nominal, usual), _on_grid(nominal, robust)
    return RobustPlan(
        replace(robust, certified=said),
        usual,
        float(worst.values[usual_at].min()),
        bool(worst.joints.feasible[usual_at].all()),
        float(nominal.values[robust_at].min()),
        len(scenarios),
    )


def _on_grid(nominal: DexterityMap, plan: SuturePlan) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of directions (n,) and the indices of positions (n,) of a plan on the map's grid."""
    choice = np.array([DIRECTIONS.index(direction) for direction in plan.directions])
    where = np.searchsorted(nominal.thetas_rad, plan.positions_rad - 1e-9)
    if (where >= len(nominal.thetas_rad)).any() or not np.allclose(nominal.thetas_rad[where], plan.positions_rad):
        raise TrocarError("robustness needs a plan on the map's grid; choose plan_even or plan_gaps")
    return choice, where
