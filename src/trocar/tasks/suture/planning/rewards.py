"""The reward of a suture, its dexterity: weighted joint margin plus manipulability (paper, III-D)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import manipulability
from trocar.errors import InvalidInput, InvalidValue, UnknownName
from trocar.geometry import TURN
from trocar.tasks.suture.demonstrations import Demonstrations
from trocar.tasks.suture.planning.primitive import SutureJoints, suture_joints
from trocar.tasks.suture.planning.setup import DIRECTIONS, Insertion, NeedleGrasp, SutureSetup, base_beside, mirrored

SURROGATE = (
    "surrogate, the needle primitive itself in the directions that can be driven: mean over two arms, the second a "
    "mirror image of the first (assumed); no demonstrations were given"
)

NO_SOLUTION = -1e3
"""The margin of a suture that no configuration of the arm can make."""
NO_REWARD = NO_SOLUTION / 100
"""Sutures with a reward up to this have no solution."""
WRIST = slice(3, 6)
"""The joints that a margin considers (paper, III-C3)."""

Array = NDArray[np.float64]
Margin = Callable[[Array, Array, Array], Array]


def paper_margin(limit: Array, largest: Array, weights: Array) -> Array:
    """Return ``|| |q_max| - q_limit ||^2`` in square degrees, as printed; it also rewards angles beyond a limit."""
    return (weights * np.degrees(limit - largest) ** 2).sum(-1)


def clipped_margin(limit: Array, largest: Array, weights: Array) -> Array:
    """Return the paper's margin with negative differences counted as zero."""
    return (weights * np.degrees(np.maximum(limit - largest, 0.0)) ** 2).sum(-1)


def normalised_margin(limit: Array, largest: Array, weights: Array) -> Array:
    """Return the sum of squared clipped differences, each divided by its limit."""
    return (weights * np.maximum(1.0 - largest / limit, 0.0) ** 2).sum(-1)


def smallest_margin(limit: Array, largest: Array, weights: Array) -> Array:
    """Return the smallest of the differences, each divided by its limit and weight; negative outside the limits."""
    counted = weights > 0
    return ((1.0 - largest / limit)[..., counted] / weights[counted]).min(-1)


MARGINS: dict[str, Margin] = {
    "smallest": smallest_margin,
    "normalised": normalised_margin,
    "clipped": clipped_margin,
    "paper": paper_margin,
}
"""Margin formulas by name; arguments are the joints' limits (j,), largest distances from the middle (..., j), and
weights (j,)."""


@dataclass(frozen=True)
class Reward:
    """How sutures are scored; the paper leaves units and clipping of the margin open.

    Attributes:
        margin: name in ``MARGINS``.
        weight: lambda, the weight of the margin; manipulability has the rest (paper: .75).
        at: where the margin is evaluated: ``stations``, at the start and end of movements, as in the paper, or
            ``path``, in between as well.
        feasible_first: whether an infeasible direction is chosen only where both are infeasible.
        joint_weights: weights of roll, wrist pitch and yaw in the margin (paper, V; it weighs them evenly).
        caution: M is the mean over the demonstrations at a place, minus this many of their standard deviations.
    """

    margin: str = "smallest"
    weight: float = 0.75
    at: str = "path"
    feasible_first: bool = True
    joint_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    caution: float = 0.0

    def __post_init__(self) -> None:
        if self.margin not in MARGINS:
            raise UnknownName("the margin", self.margin, MARGINS)
        if self.at not in ("stations", "path"):
            raise UnknownName("the place of the margin", self.at, ("stations", "path"))
        if not (math.isfinite(self.weight) and 0.0 <= self.weight <= 1.0):
            raise InvalidValue("the weight lambda", f"{self.weight:g}", "give 0 to 1")
        weights = self.joint_weights
        if len(weights) != 3 or not all(0 <= weight < math.inf for weight in weights) or not any(weights):
            remedy = "give three for roll, wrist pitch and yaw, 0 or more, not all 0"
            raise InvalidValue("the joints' weights", ", ".join(f"{weight:g}" for weight in weights), remedy)
        if not 0 <= self.caution < math.inf:
            raise InvalidValue("the caution", f"{self.caution:g}", "give 0 standard deviations or more")


@dataclass(frozen=True, eq=False)
class DexterityMap:
    """Dexterity of sutures all round the circle, in both directions.

    Attributes:
        setup: the geometry.
        reward: how sutures are scored.
        joints: configurations along the sutures.
        margin: (2, n) joint margin Q before scaling, one row per direction of ``DIRECTIONS``.
        by_arm: (arms, n) mean squared manipulability of each arm, the one that drives the needle first (paper, Fig. 6);
            it does not depend on the direction.
        manipulability: (n,) M before scaling: the mean over the arms, less the caution.
        values: (2, n) dexterity D of each direction.
        choice: (n,) row of the better direction.
        scales: units of margin and manipulability: their largest values, which become 1.
        recorded: demonstrations that M comes from; None for the surrogate.
    """

    setup: SutureSetup
    reward: Reward
    joints: SutureJoints
    margin: NDArray[np.float64]
    by_arm: NDArray[np.float64]
    manipulability: NDArray[np.float64]
    values: NDArray[np.float64]
    choice: NDArray[np.intp]
    scales: tuple[float, float]
    recorded: Demonstrations | None = None

    def __repr__(self) -> str:
        low, high = float(self.values.min()), float(self.values.max())
        feasible = int(self.joints.feasible.any(axis=0).sum())
        return (
            f"<DexterityMap of {len(self.thetas_rad)} positions: dexterity {low:.3f} to {high:.3f}, "
            f"{feasible} positions within the limits>"
        )

    def at(self, thetas_rad: ArrayLike) -> DexterityMap:
        """Return the dexterity of sutures at other positions (n,), scaled like this map."""
        return scored(self.setup, self.reward, suture_joints(self.setup, thetas_rad), self.recorded, self.scales)

    @property
    def source(self) -> str:
        """Return where M comes from, in words."""
        return self.recorded.source if self.recorded else SURROGATE

    @property
    def thetas_rad(self) -> NDArray[np.float64]:
        """Return the positions (n,)."""
        return self.joints.thetas_rad

    def chosen(self, values: NDArray) -> NDArray:
        """Return, of values (2, n, ...) in both directions, those in the better direction (n, ...)."""
        return values[self.choice, np.arange(len(self.choice))]

    @property
    def best(self) -> NDArray[np.float64]:
        """Return the dexterity (n,) in the better direction."""
        return self.chosen(self.values)

    @property
    def directions(self) -> NDArray[np.intp]:
        """Return the better direction (n,), each one of ``DIRECTIONS``."""
        return np.array(DIRECTIONS)[self.choice]

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Return whether the suture (n,) in the better direction is feasible."""
        return self.chosen(self.joints.feasible)

    def span(self, rewards: NDArray[np.float64]) -> tuple[float, float]:
        """Return the smallest and largest of rewards (k,) and of all feasible sutures, in either direction.

        Rewards of sutures for which the arm has no joints do not count; (0, 1) if there are no others.
        """
        seen = np.append(rewards, self.values[self.joints.feasible])
        seen = seen[seen > NO_REWARD]
        return (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)

    @property
    def switches_rad(self) -> NDArray[np.float64]:
        """Return the positions at which the better direction differs from that of the position before."""
        return self.thetas_rad[self.choice != np.roll(self.choice, 1)]


def dexterity(
    setup: SutureSetup, reward: Reward | None = None, positions: int = 360, recorded: Demonstrations | None = None
) -> DexterityMap:
    """Return the dexterity of sutures at evenly spaced positions, in both directions.

    Args:
        setup: the geometry.
        reward: how sutures are scored; default: smallest normalised margin, lambda .75.
        positions: number of positions, the first at theta = 0.
        recorded: demonstrations that M comes from; default: the surrogate.
    """
    if not 4 <= positions <= 100_000:
        raise InvalidValue("the number of positions", positions, "give 4 to 100000")
    thetas = np.arange(positions, dtype=np.float64) * (TURN / positions)
    return scored(setup, reward or Reward(), suture_joints(setup, thetas), recorded)


def scored(
    setup: SutureSetup,
    reward: Reward,
    joints: SutureJoints,
    recorded: Demonstrations | None = None,
    scales: tuple[float, float] | None = None,
) -> DexterityMap:
    """Return the dexterity of sutures with these joints, scaled by their own maxima unless ``scales`` are given."""
    margin = joint_margin(joints, reward)
    by_arm = recorded.per_arm_at(joints.thetas_rad) if recorded else surrogate_by_arm(setup, joints)
    given = by_arm.mean(0)
    if reward.caution:
        if recorded is None:
            remedy = "give --demonstrations, or drop the caution"
            raise InvalidInput("a caution", "needs the variance of recorded sutures", remedy)
        given = np.maximum(given - reward.caution * recorded.sd_at(joints.thetas_rad), 0.0)
    # a second arm forbids sutures but must not change rewards, so scales come from what is drivable
    drive, choice = (
        np.argmax(margin - 1e9 * ~can if reward.feasible_first else margin, axis=0)
        for can in (joints.drivable, joints.feasible)
    )
    scales = scales or (_unit(np.take_along_axis(margin, drive[None], 0)[0]), _unit(given))
    values = reward.weight * margin / scales[0] + (1.0 - reward.weight) * given / scales[1]
    return DexterityMap(setup, reward, joints, margin, by_arm, given, values, choice, scales, recorded)


def _unit(values: NDArray[np.float64]) -> float:
    largest = float(values.max())
    return largest if largest > 0 else 1.0


def joint_margin(joints: SutureJoints, reward: Reward) -> NDArray[np.float64]:
    """Return Q (2, n) of both directions before scaling; ``NO_SOLUTION`` where the arm has none."""
    arm = joints.arm
    q = joints.q[:, :, joints.station] if reward.at == "stations" else joints.q
    largest = np.maximum(q.max(2) - arm.middle, arm.middle - q.min(2))
    limit = (arm.upper - arm.lower) / 2
    found = MARGINS[reward.margin](limit[WRIST], largest[..., WRIST], np.array(reward.joint_weights))
    return np.nan_to_num(found, nan=NO_SOLUTION)


def surrogate_by_arm(setup: SutureSetup, joints: SutureJoints) -> NDArray[np.float64]:
    """Return the mean squared manipulability (2, n) of two arms over the primitive, in place of demonstrations.

    The second arm is the mirror image of the first one. The paper's ``|J J^T|`` is the square of Yoshikawa's measure.
    Only directions that an arm can drive count; where it can drive neither, both count.
    """
    second = suture_joints(mirrored(setup), joints.thetas_rad)
    return np.stack([_mean_squared(arm) for arm in (joints, second)])


def _mean_squared(joints: SutureJoints) -> NDArray[np.float64]:
    known = np.isfinite(joints.q)
    q = joints.q if known.all() else np.where(known, joints.q, 0.0)
    squares = (manipulability(joints.arm, q) ** 2).mean(2)
    driven = np.where(joints.drivable.any(0), joints.drivable, True)
    return (squares * driven).sum(0) / driven.sum(0)


@dataclass(frozen=True)
class Preset:
    """A setup and the reward that scores its sutures.

    Attributes:
        fitted: the setup's parameters, named as on the command line, that were fitted to the paper's figures;
            agreement with these figures is no prediction.
    """

    setup: SutureSetup
    reward: Reward
    fitted: tuple[str, ...] = ()


PRESETS: dict[str, Preset] = {
    # Flat jaws can hold the needle, the wrist stays clear of the tissue, and every position is within reach. The base
    # stands where the demo's does; the angles of base and grasp maximise the worst position, in steps of 5 degrees.
    "default": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(40.0), spin_rad=radians(-135.0)),
            grasp=NeedleGrasp(radians(135.0), approach_rad=radians(-10.0), lean_rad=radians(30.0)),
        ),
        Reward(),
    ),
    # Five parameters are fitted to the paper's Table I, Fig. 3 and Fig. 7 together: plausible, no proof.
    "paper-demo": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(20.3), spin_rad=radians(116.4)),
            grasp=NeedleGrasp(radians(131.2), approach_rad=radians(-32.1), lean_rad=radians(49.5)),
            insertion=Insertion(theta_is="entry"),
        ),
        Reward(margin="clipped", at="stations", feasible_first=False),
        ("base_tilt_deg", "base_spin_deg", "grasp_behind_tip_deg", "grasp_approach_deg", "grasp_lean_deg"),
    ),
}
"""Setups by their name on the command line."""
