"""The paper's experiments (section IV) on any setup: Table I and the data of Figs. 3 to 7."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry import SE3, TURN
from trocar.tasks.suture.planning.joints import suture_joints
from trocar.tasks.suture.planning.rewards import DexterityMap, Reward, dexterity, surrogate_manipulability
from trocar.tasks.suture.planning.setup import SutureSetup

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


@dataclass(frozen=True, eq=False)
class Table1:
    """Table I: mean and maximum over all evenly spaced plans, by the allowed directions.

    Attributes:
        points: (2, 3) rows as ``LOCATIONS``, columns as ``ALLOWED``; 100 is the best plan.
    """

    points: NDArray[np.float64]

    @property
    def off_paper(self) -> NDArray[np.float64]:
        """Return the differences (2, 3) of the entries from the paper's, in points."""
        return self.points - PAPER_TABLE_1

    def gains(self) -> dict[str, dict[str, float]]:
        """Return the gain of the best plan over three baselines, as a difference in points and a ratio in percent.

        The paper's "11-57 %" are differences in points (``facts/suture.md``).
        """
        baselines = {
            "random location, best direction": self.points[0, 2],
            "optimal location, better fixed direction": self.points[1, :2].max(),
            "random location, worse fixed direction": self.points[0, :2].min(),
        }
        return {name: _gain(self.points[1, 2], float(of)) for name, of in baselines.items()}

    def summary(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "points": _cells(self.points),
            "paper_points": _cells(PAPER_TABLE_1),
            "largest_difference_points": float(np.abs(self.off_paper).max()),
            "gains": self.gains(),
            "paper_gains": Table1(PAPER_TABLE_1).gains(),
        }


def _gain(best: float, of: float) -> dict[str, float]:
    """Return difference and ratio; a baseline that is not positive has no ratio."""
    return {"points": float(best - of), "ratio_percent": float(100 * (best / of - 1)) if of > 0 else float("inf")}


def _cells(points: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Return the entries by location and allowed direction."""
    return {
        location: {allowed: float(points[i, j]) for j, allowed in enumerate(ALLOWED)}
        for i, location in enumerate(LOCATIONS)
    }


def plan_values(values: NDArray[np.float64], count: int = SUTURES) -> NDArray[np.float64]:
    """Return the worst suture (..., n / count) of each evenly spaced plan, by theta_1, from values (..., n)."""
    n = values.shape[-1]
    if count < 1 or n % count:
        raise TrocarError(f"{n} positions do not hold {count} evenly spaced sutures; give a multiple of {count}")
    return values.reshape(*values.shape[:-1], count, n // count).min(-2)


def table_1(dexterity_map: DexterityMap) -> Table1:
    """Return Table I of these sutures; the mean over random locations is exact, over all plans."""
    values = np.vstack([dexterity_map.values, dexterity_map.best])
    plans = plan_values(values)
    best = plans[2].max()
    if not best > 0:
        raise TrocarError(
            f"the best plan has reward {best:.3g}, so that no points can be given relative to it; "
            "choose a setup with a feasible plan"
        )
    return Table1(100 * np.vstack([plans.mean(-1), plans.max(-1)]) / best)


@dataclass(frozen=True, eq=False)
class LambdaSweep:
    """Fig. 7: reward of each evenly spaced plan at several lambda.

    Margin and manipulability are first scaled so that the best plan by either of them alone has reward 10.

    Attributes:
        weights: (k,) values of lambda.
        thetas_rad: (m,) theta_1 of the plans.
        rewards: (k, m) their rewards.
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
        """Return how far the best plan turns from the first lambda to the last, each step the shorter way round.

        Plans a quarter of a turn apart are the same, so theta_1 is periodic in the gap between two sutures.
        """
        turned = np.unwrap(self.best_theta_rad, period=TURN / SUTURES)
        return float(turned[-1] - turned[0])

    @property
    def off_paper_deg(self) -> tuple[float, float, float]:
        """Return how far theta_1 at the first and last lambda, and the travel between them, are from the paper's."""
        gap, (start, end) = 360 / SUTURES, PAPER_BEST_THETA_DEG
        ends = np.degrees(self.best_theta_rad[[0, -1]]) - PAPER_BEST_THETA_DEG
        first, last = np.abs((ends + gap / 2) % gap - gap / 2)
        return float(first), float(last), float(abs(np.degrees(self.travel_rad) - (end - start)))

    def summary(self) -> dict[str, Any]:
        """Return everything except the curves as plain values."""
        return {
            "weights": self.weights.tolist(),
            "best_theta_deg": np.degrees(self.best_theta_rad).round(6).tolist(),
            "best_reward": self.rewards.max(1).tolist(),
            "travel_deg": float(np.degrees(self.travel_rad)),
            "paper_best_theta_deg": list(PAPER_BEST_THETA_DEG),
            "off_paper_deg": list(self.off_paper_deg),
            "reproduces_paper": max(self.off_paper_deg) <= NEAR_DEG,
        }


def lambda_sweep(dexterity_map: DexterityMap, weights: Sequence[float] = SWEEP) -> LambdaSweep:
    """Return the plans' rewards at these values of lambda, each suture in the map's better direction."""
    if not len(weights) or not all(0 <= weight <= 1 for weight in weights):
        raise TrocarError(f"the weights lambda are {list(weights)}; give one or more, each 0 to 1")
    margin = np.take_along_axis(dexterity_map.margin, dexterity_map.choice[None], 0)[0]
    scaled = [_to_ten(margin), _to_ten(dexterity_map.manipulability)]
    share = np.asarray(weights, dtype=np.float64)[:, None]
    plans = plan_values(share * scaled[0] + (1 - share) * scaled[1])
    return LambdaSweep(share[:, 0], dexterity_map.thetas_rad[: plans.shape[1]], plans)


def _to_ten(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (n,) scaled so that the best plan has reward 10."""
    best = plan_values(values).max()
    return 10 * values / best if best > 0 else values


def mirrored(setup: SutureSetup) -> SutureSetup:
    """Return the mirror image of a setup in the y-z plane of its circle: base and grasp on the other side.

    An arm that is symmetric about the plane of its yaw axis, as the PSM is, then moves at pi - theta, in the other
    direction, as it did at theta. The paper does not say where its second arm stands or how it holds the needle.
    """
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    T_circle_base = setup.T_base_circle.inverse().matrix
    grasp = replace(setup.grasp, approach_rad=-setup.grasp.approach_rad, skew_rad=-setup.grasp.skew_rad)
    base = setup.circle.T_world_circle @ SE3.unchecked(flip @ T_circle_base @ flip)
    return replace(setup, T_world_base=base, grasp=grasp)


@dataclass(frozen=True, eq=False)
class SutureStudy:
    """The paper's experiments on one setup.

    Attributes:
        dexterity: margins in both directions (Fig. 5), better directions (Fig. 3), dexterities.
        table: Table I.
        sweep: Fig. 7.
        assistant: setup of the second arm, which extracts the needle.
        assistant_manipulability: (n,) M of the second arm (Fig. 6).
        assistant_source: where that M comes from, in words.
    """

    dexterity: DexterityMap
    table: Table1
    sweep: LambdaSweep
    assistant: SutureSetup
    assistant_manipulability: NDArray[np.float64]
    assistant_source: str

    @property
    def thetas_rad(self) -> NDArray[np.float64]:
        """Return the positions (n,)."""
        return self.dexterity.thetas_rad

    @property
    def manipulability(self) -> NDArray[np.float64]:
        """Return M of both arms (2, n), the arm that drives the needle first (Fig. 6)."""
        return np.stack([self.dexterity.manipulability, self.assistant_manipulability])

    @property
    def wrist_rad(self) -> NDArray[np.float64]:
        """Return the largest |angle| (n, 3) of roll, wrist pitch and yaw in the better direction (Fig. 4)."""
        choice = self.dexterity.choice[None, :, None]
        return np.take_along_axis(self.dexterity.joints.largest_wrist_rad, choice, 0)[0]

    @property
    def best_theta_rad(self) -> float:
        """Return theta_1 of the best plan at the reward's lambda."""
        return float(self.thetas_rad[np.argmax(plan_values(self.dexterity.best))])

    @property
    def wrist_limits_rad(self) -> NDArray[np.float64]:
        """Return the upper limits (3,) of roll, wrist pitch and yaw."""
        return self.dexterity.setup.arm.upper[3:]

    def summary(self) -> dict[str, Any]:
        """Return everything except the curves as plain values."""
        found = self.dexterity
        switches = np.degrees(found.switches_rad)
        return {
            "table_1": self.table.summary(),
            "switches_deg": switches.tolist(),
            "paper_switches_deg": list(PAPER_SWITCHES_DEG),
            "switches_off_paper_deg": switches_off_deg(switches),
            "infeasible_positions": int((~found.feasible).sum()),
            "positions": len(found.thetas_rad),
            "largest_wrist_deg": np.degrees(self.wrist_rad.max(0)).tolist(),
            "wrist_limits_deg": np.degrees(self.wrist_limits_rad).tolist(),
            "margin": found.reward.margin,
            "weight": found.reward.weight,
            "best_theta_deg": float(np.degrees(self.best_theta_rad).round(6)),
            "lambda_sweep": self.sweep.summary(),
            "manipulability_highest_at_deg": np.degrees(self.thetas_rad[self.manipulability.argmax(1)]).tolist(),
            "manipulability_source": found.source,
            "assistant_source": self.assistant_source,
        }


def switches_off_deg(switches_deg: NDArray[np.float64]) -> list[float]:
    """Return the distance from each switch of the paper to the nearest of these; infinite if there are none."""
    off = [np.abs((switches_deg - at + 180) % 360 - 180) for at in PAPER_SWITCHES_DEG]
    return [float(turns.min(initial=np.inf)) for turns in off]


def study(
    setup: SutureSetup,
    reward: Reward | None = None,
    positions: int = 360,
    assistant: SutureSetup | None = None,
    weights: Sequence[float] = SWEEP,
    manipulability_at: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
    source: str = "",
) -> SutureStudy:
    """Return the paper's experiments on a setup.

    Args:
        setup: the geometry.
        reward: how sutures are scored.
        positions: number of positions, a multiple of four.
        assistant: setup of the second arm, which extracts the needle; default: mirror image of the first (assumed).
        weights: values of lambda for the sweep.
        manipulability_at: returns M at positions (n,) rad, from demonstrations; default: the surrogate.
        source: where that M comes from, in words.
    """
    found = dexterity(setup, reward, positions, manipulability_at, source)
    helper = assistant or mirrored(setup)
    how = "the mirror image of the first arm (assumed)" if assistant is None else "as given"
    return SutureStudy(
        found,
        table_1(found),
        lambda_sweep(found, weights),
        helper,
        surrogate_manipulability(suture_joints(helper, found.thetas_rad)),
        f"surrogate: the second arm drives the same primitive, {how}",
    )
