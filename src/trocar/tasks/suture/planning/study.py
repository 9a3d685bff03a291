"""The paper's experiments (section IV) on any setup: Table I and the data of Figs. 3 to 7."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InvalidInput, InvalidValue
from trocar.geometry import TURN
from trocar.tasks.suture.planning.rewards import DexterityMap

LOCATIONS = ("random", "optimal")
ALLOWED = ("clockwise", "counterclockwise", "best")
"""Rows and columns of Table I."""
PAPER_TABLE_1 = np.array([[60.2, 42.8, 88.6], [65.6, 50.6, 100.0]])
"""Table I of Thananjeyan et al., rows as ``LOCATIONS``, columns as ``ALLOWED``; 100 is the best."""
PAPER_SWITCHES_DEG = (67.0, 228.0)
"""Where the paper's best direction changes (Figs. 3 to 5)."""
PAPER_BEST_THETA_DEG = (28.0, 11.0)
"""The paper's best theta_1 at its smallest and largest lambda (Fig. 7), whose values it does not give."""
NEAR_DEG = 5.0
"""Angles this near to the paper's count as reproduced."""
SWEEP = tuple(k / 10 for k in range(11))
"""Values of lambda for Fig. 7."""
SUTURES = 4


def plan_values(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the worst suture (..., n / 4) of each evenly spaced plan, by theta_1, from values (..., n)."""
    n = values.shape[-1]
    if n % SUTURES:
        sutures = f"do not hold {SUTURES} evenly spaced sutures"
        raise InvalidInput(f"{n} positions", sutures, f"give a multiple of {SUTURES}")
    return values.reshape(*values.shape[:-1], SUTURES, n // SUTURES).min(-2)


def table_1(map: DexterityMap) -> NDArray[np.float64]:
    """Return Table I of these sutures (2, 3), rows as ``LOCATIONS``, columns as ``ALLOWED``; 100 is the best plan.

    These are the mean and the maximum over all evenly spaced plans.
    """
    plans = plan_values(np.vstack([map.values, map.best]))
    best = plans[2].max()
    if not best > 0:
        problem = f"has reward {best:.3g}, so that no points can be given relative to it"
        raise InvalidInput("the best plan", problem, "choose a setup with a feasible plan")
    return 100 * np.vstack([plans.mean(-1), plans.max(-1)]) / best


def by_name(points: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Return the entries of Table I by location and allowed directions."""
    rows = zip(LOCATIONS, points.tolist(), strict=True)
    return {location: dict(zip(ALLOWED, row, strict=True)) for location, row in rows}


def gains(points: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Return the gain of Table I's best plan over three baselines, as a difference in points and a ratio in percent.

    The paper's "11-57 %" are differences in points.
    """
    best = points[1, 2]
    baselines = {
        "random location, best direction": points[0, 2],
        "optimal location, better fixed direction": points[1, :2].max(),
        "random location, worse fixed direction": points[0, :2].min(),
    }
    ratios = {name: float(100 * (best / of - 1)) if of > 0 else float("inf") for name, of in baselines.items()}
    return {name: {"points": float(best - of), "ratio_percent": ratios[name]} for name, of in baselines.items()}


@dataclass(frozen=True, eq=False)
class LambdaSweep:
    """Fig. 7: reward of each evenly spaced plan at several lambda.

    Margin and manipulability are first scaled so that the best plan by either of them alone has reward 10.

    Attributes:
        weights: (k,) values of lambda.
        thetas_rad: (m,) theta_1 of the plans.
        rewards: (k, m) of the plans.
    """

    weights: NDArray[np.float64]
    thetas_rad: NDArray[np.float64]
    rewards: NDArray[np.float64]

    @property
    def best_theta_rad(self) -> NDArray[np.float64]:
        """Return theta_1 (k,) of the best plan at each lambda."""
        return self.thetas_rad[np.argmax(self.rewards, axis=1)]

    @property
    def travel_rad(self) -> float:
        """Return how far the best plan turns from the first lambda to the last, taking the shorter way at each step.

        Plans a quarter of a turn apart are the same, so theta_1 is periodic in the gap between two sutures.
        """
        turned = self._unwound_rad
        return float(turned[-1] - turned[0])

    @property
    def _unwound_rad(self) -> NDArray[np.float64]:
        return np.unwrap(self.best_theta_rad, period=TURN / SUTURES)

    @property
    def like_paper(self) -> tuple[int, int] | None:
        """Return the indices of two lambdas between which the best plan turns as in the paper; None if there are none.

        The paper gives no values of lambda. At the smaller lambda, the best theta_1 is near the paper's first; at the
        larger one, it is near the paper's last; in between it only turns that way, apart from single steps of the grid.
        Of several such pairs, the one nearest to the paper is returned.
        """
        (first, last), gap = np.radians(PAPER_BEST_THETA_DEG), TURN / SUTURES
        turned, near = self._unwound_rad, np.radians(NEAR_DEG) + 1e-9
        away = np.abs((turned - np.array([[first], [last]]) + gap / 2) % gap - gap / 2)
        step = self.thetas_rad[1] - self.thetas_rad[0] + 1e-9
        pairs = []
        for start, end in combinations(range(len(turned)), 2):
            steps = np.diff(turned[start : end + 1]) * np.sign(last - first)
            if away[0, start] <= near and away[1, end] <= near and (steps >= -step).all() and steps.sum() > 0:
                pairs.append((start, end))
        return min(pairs, key=lambda pair: away[0, pair[0]] + away[1, pair[1]], default=None)

    def summary(self) -> dict[str, Any]:
        """Return everything except the curves as plain values."""
        found = self.like_paper
        return {
            "weights": self.weights.tolist(),
            "best_theta_deg": np.degrees(self.best_theta_rad).round(6).tolist(),
            "best_reward": self.rewards.max(1).tolist(),
            "travel_deg": float(np.degrees(self.travel_rad)),
            "paper_best_theta_deg": list(PAPER_BEST_THETA_DEG),
            "reproduces_paper": found is not None,
            "like_paper_weights": None if found is None else self.weights[list(found)].tolist(),
        }


def lambda_sweep(map: DexterityMap, weights: Sequence[float] = SWEEP) -> LambdaSweep:
    """Return the plans' rewards at these values of lambda, each suture in the map's better direction."""
    if not len(weights) or not all(0 <= weight <= 1 for weight in weights):
        raise InvalidValue("the list of weights lambda", list(weights), "give one or more, each 0 to 1")
    margin, given = (_to_ten(values) for values in (map.chosen(map.margin), map.manipulability))
    share = np.asarray(weights, dtype=np.float64)[:, None]
    plans = plan_values(share * margin + (1 - share) * given)
    return LambdaSweep(share[:, 0], map.thetas_rad[: plans.shape[1]], plans)


def _to_ten(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (n,) scaled so that the best plan has reward 10."""
    best = plan_values(values).max()
    return 10 * values / best if best > 0 else values


@dataclass(frozen=True, eq=False)
class SutureStudy:
    """The paper's experiments on one setup.

    Attributes:
        map: margins in both directions (Fig. 5), better directions (Fig. 3), dexterities.
        points: (2, 3) Table I, as :func:`table_1` returns it.
        sweep: Fig. 7.
        fitted: parameters of the setup that were fitted to these figures.
    """

    map: DexterityMap
    points: NDArray[np.float64]
    sweep: LambdaSweep
    fitted: tuple[str, ...] = ()

    @property
    def wrist_rad(self) -> NDArray[np.float64]:
        """Return the largest |angle| (n, 3) of roll, wrist pitch and yaw in the better direction (Fig. 4)."""
        return self.map.chosen(self.map.joints.largest_wrist_rad)

    def summary(self) -> dict[str, Any]:
        """Return everything except the curves as plain values."""
        map = self.map
        switches, best = np.degrees(map.switches_rad), int(np.argmax(plan_values(map.best)))
        return {
            "table_1": {
                "points": by_name(self.points),
                "paper_points": by_name(PAPER_TABLE_1),
                "largest_difference_points": float(np.abs(self.points - PAPER_TABLE_1).max()),
                "gains": gains(self.points),
                "paper_gains": gains(PAPER_TABLE_1),
            },
            "switches_deg": switches.tolist(),
            "paper_switches_deg": list(PAPER_SWITCHES_DEG),
            "switches_off_paper_deg": [
                float(np.abs((switches - at + 180) % 360 - 180).min(initial=np.inf)) for at in PAPER_SWITCHES_DEG
            ],
            "infeasible_positions": int((~map.feasible).sum()),
            "positions": len(map.thetas_rad),
            "largest_wrist_deg": np.degrees(self.wrist_rad.max(0)).tolist(),
            "wrist_limits_deg": np.degrees(map.setup.arm.upper[3:]).tolist(),
            "margin": map.reward.margin,
            "weight": map.reward.weight,
            "best_theta_deg": float(np.degrees(map.thetas_rad[best]).round(6)),
            "lambda_sweep": self.sweep.summary(),
            "manipulability_highest_at_deg": np.degrees(map.thetas_rad[map.by_arm.argmax(1)]).tolist(),
            "manipulability_source": map.source,
            "fitted": list(self.fitted),
        }


def study(map: DexterityMap, fitted: tuple[str, ...] = ()) -> SutureStudy:
    """Return the paper's experiments on a setup.

    Args:
        map: the setup's map; the number of positions has to be a multiple of four.
        fitted: names of the setup's parameters that were fitted to the paper's figures.
    """
    return SutureStudy(map, table_1(map), lambda_sweep(map), fitted)


def fitted_note(fitted: Sequence[str]) -> str:
    """Return a sentence that names what was fitted, to stand beside every fitted figure; empty if nothing was."""
    if not fitted:
        return ""
    named = ", ".join(name.rpartition("_")[0].replace("_", " ") for name in fitted)
    return f"{len(fitted)} numbers of the setup ({named}) were fitted to the paper's Table I, Fig. 3 and Fig. 7"
