"""The reward of a suture, its dexterity: weighted joint margin plus manipulability (paper, III-D)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import manipulability
from trocar.errors import InvalidValue, UnknownName
from trocar.geometry import TURN
from trocar.tasks.suture.demonstrations import Demonstrations
from trocar.tasks.suture.planning.primitive import SutureJoints, suture_joints
from trocar.tasks.suture.planning.setup import DIRECTIONS, NeedleGrasp, SutureSetup, base_beside

SURROGATE = "surrogate: the needle primitive itself, both directions; no demonstrations were given"

NO_SOLUTION = -1e3
"""The margin of a suture that no configuration of the arm can make."""
WRIST = slice(3, 6)
"""The joints that a margin considers (paper, III-C3)."""

Margin = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def paper_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``|| |q_max| - q_limit ||^2`` in square degrees, as printed; it also rewards angles beyond a limit."""
    return (np.degrees(limit - largest) ** 2).sum(-1)


def clipped_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the paper's margin with negative differences counted as zero."""
    return (np.degrees(np.maximum(limit - largest, 0.0)) ** 2).sum(-1)


def normalised_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of squared clipped differences, each divided by its limit."""
    return (np.maximum(1.0 - largest / limit, 0.0) ** 2).sum(-1)


def smallest_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest of the differences, each divided by its limit; negative outside the limits."""
    return (1.0 - largest / limit).min(-1)


MARGINS: dict[str, Margin] = {
    "smallest": smallest_margin,
    "normalised": normalised_margin,
    "clipped": clipped_margin,
    "paper": paper_margin,
}
"""Margin formulas by name; arguments are the joints' limits (j,) and largest distances from the middle (..., j)."""


@dataclass(frozen=True)
class Reward:
    """How sutures are scored; the paper leaves units and clipping of the margin open.

    Attributes:
        margin: name in ``MARGINS``.
        weight: lambda, the weight of the margin; manipulability has the rest (paper: .75).
        at: where the margin is evaluated: ``stations``, at the start and end of movements, as in the paper, or
            ``path``, in between as well.
        feasible_first: whether an infeasible direction is chosen only where both are infeasible.
    """

    margin: str = "smallest"
    weight: float = 0.75
    at: str = "path"
    feasible_first: bool = True

    def __post_init__(self) -> None:
        if self.margin not in MARGINS:
            raise UnknownName("the margin", self.margin, MARGINS)
        if self.at not in ("stations", "path"):
            raise UnknownName("the place of the margin", self.at, ("stations", "path"))
        if not (math.isfinite(self.weight) and 0.0 <= self.weight <= 1.0):
            raise InvalidValue("the weight lambda", f"{self.weight:g}", "give 0 to 1")


@dataclass(frozen=True, eq=False)
class DexterityMap:
    """Dexterity of sutures all round the circle, in both directions.

    Attributes:
        setup: the geometry.
        reward: how sutures are scored.
        joints: configurations along the sutures.
        margin: (2, n) joint margin Q before scaling, one row per direction of ``DIRECTIONS``.
        manipulability: (n,) mean squared manipulability M before scaling; it does not depend on the direction.
        values: (2, n) dexterity D of each direction.
        choice: (n,) row of the better direction.
        scales: units of margin and manipulability: their largest values, which become 1.
        recorded: demonstrations that M comes from; None for the surrogate.
    """

    setup: SutureSetup
    reward: Reward
    joints: SutureJoints
    margin: NDArray[np.float64]
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
        """Return values (2, n, ...) of both directions in the better direction (n, ...)."""
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
        """Return the smallest and largest of rewards (k,) and of all feasible sutures, in either direction."""
        seen = np.append(rewards, self.values[self.joints.feasible])
        return float(seen.min()), float(seen.max())

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
    given = recorded.manipulability_at(joints.thetas_rad) if recorded else surrogate_manipulability(joints)
    choice = np.argmax(margin - 1e9 * ~joints.feasible if reward.feasible_first else margin, axis=0)
    scales = scales or (_unit(np.take_along_axis(margin, choice[None], 0)[0]), _unit(given))
    values = reward.weight * margin / scales[0] + (1.0 - reward.weight) * given / scales[1]
    return DexterityMap(setup, reward, joints, margin, given, values, choice, scales, recorded)


def _unit(values: NDArray[np.float64]) -> float:
    largest = float(values.max())
    return largest if largest > 0 else 1.0


def joint_margin(joints: SutureJoints, reward: Reward) -> NDArray[np.float64]:
    """Return Q (2, n) of both directions before scaling; ``NO_SOLUTION`` where the arm has none."""
    arm = joints.arm
    q = joints.q[:, :, joints.station] if reward.at == "stations" else joints.q
    largest = np.maximum(q.max(2) - arm.middle, arm.middle - q.min(2))
    limit = (arm.upper - arm.lower) / 2
    return np.nan_to_num(MARGINS[reward.margin](limit[WRIST], largest[..., WRIST]), nan=NO_SOLUTION)


def surrogate_manipulability(joints: SutureJoints) -> NDArray[np.float64]:
    """Return the mean squared manipulability (n,) over the primitive in both directions, in place of demonstrations.

    ``|J J^T|`` of the paper is the square of Yoshikawa's measure.
    """
    known = np.isfinite(joints.q)
    q = joints.q if known.all() else np.where(known, joints.q, 0.0)
    return (manipulability(joints.arm, q) ** 2).mean((0, 2))


@dataclass(frozen=True)
class Preset:
    """A setup and the reward that scores its sutures."""

    setup: SutureSetup
    reward: Reward


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
    # Five parameters (spin, tilt, approach, lean, skew) are fitted to the paper's Table I and Fig. 3: the agreement is
    # plausible, no proof. Flat jaws could not hold the needle in this grasp.
    "paper-demo": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(-40.0), spin_rad=radians(-30.5)),
            grasp=NeedleGrasp(approach_rad=radians(26.2), lean_rad=radians(51.0), skew_rad=radians(90.5)),
        ),
        Reward(margin="clipped", at="stations", feasible_first=False),
    ),
}
"""Setups by their name on the command line."""
