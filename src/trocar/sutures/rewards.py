"""What makes a suture good: distance to the joint limits, manipulability, and their weighted sum (paper, III-D)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, manipulability
from trocar.errors import TrocarError
from trocar.sutures.joints import SutureJoints, suture_joints
from trocar.sutures.setup import DIRECTIONS, SutureSetup

SURROGATE = "surrogate: the needle primitive itself, both directions; no demonstrations were given"

NO_SOLUTION = -1e3
"""The margin of a suture that the arm has no configurations for."""

JOINTS = {"wrist": slice(3, 6), "all": slice(0, 6)}
"""Which joints a margin looks at, by name; the paper: the wrist's (III-C3)."""

Margin = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def paper_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``|| |q_max| - q_limit ||^2`` in square degrees, as printed: it rewards angles beyond a limit too."""
    return (np.degrees(limit - largest) ** 2).sum(-1)


def clipped_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same with differences below zero counted as zero."""
    return (np.degrees(np.maximum(limit - largest, 0.0)) ** 2).sum(-1)


def normalised_margin(limit: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of squares of the clipped differences, each divided by its limit."""
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
"""Formulas of the margin by name: of the joints' limits (j,) and their largest distances from the middle (..., j)."""


Scaling = Callable[[NDArray[np.float64]], tuple[float, float]]


def by_most(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return what to subtract (nothing) and to divide by, so that the largest value becomes 1."""
    most = float(values.max())
    return 0.0, most if most > 0 else 1.0


def by_range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return what to subtract and to divide by, so that the values fill 0 to 1."""
    low, high = float(values.min()), float(values.max())
    return low, high - low if high > low else 1.0


SCALINGS: dict[str, Scaling] = {"most": by_most, "range": by_range}
"""How margin and manipulability come to "occupy the same range" (paper, III-D3), by name."""

Scales = tuple[tuple[float, float], tuple[float, float]]
ManipulabilityAt = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Reward:
    """How sutures are judged; the paper leaves the formula's units, clipping and scaling open.

    Attributes:
        margin: name in ``MARGINS``.
        weight: lambda, the share of the margin; the rest is manipulability (paper: .75).
        scaling: name in ``SCALINGS``.
        joints: name in ``JOINTS``; the insertion has no degrees, so ``all`` needs a margin that is normalised.
        at: ``stations``, where movements start and end, as in the paper, or ``path``, also in between.
        feasible_first: a direction outside the limits is taken only where there is no other.
    """

    margin: str = "smallest"
    weight: float = 0.75
    scaling: str = "most"
    joints: str = "wrist"
    at: str = "path"
    feasible_first: bool = True

    def __post_init__(self) -> None:
        for what, value, choices in (
            ("margin", self.margin, MARGINS),
            ("scaling", self.scaling, SCALINGS),
            ("set of joints", self.joints, JOINTS),
            ("place of the margin", self.at, ("stations", "path")),
        ):
            if value not in choices:
                raise TrocarError(f"the {what} {value!r} is unknown; choose one of {', '.join(choices)}")
        if self.joints == "all" and self.margin not in ("smallest", "normalised"):
            raise TrocarError(
                f"the margin {self.margin!r} counts degrees and the insertion has none; with all joints choose "
                "smallest or normalised"
            )
        if not (math.isfinite(self.weight) and 0.0 <= self.weight <= 1.0):
            raise TrocarError(f"the weight lambda is {self.weight:g}; give 0 to 1")


@dataclass(frozen=True, eq=False)
class DexterityMap:
    """What sutures all round the circle are worth.

    Attributes:
        setup: of which.
        reward: by what measure.
        joints: configurations along the sutures.
        margin: (2, n) joint margin Q before scaling, one row a direction of ``DIRECTIONS``.
        manipulability: (n,) mean squared manipulability M before scaling; it does not depend on the direction.
        source: where M comes from, in words.
        values: (2, n) dexterity D of each direction.
        choice: (n,) row of the better direction.
        scales: what margin, then manipulability, were scaled by: (subtracted, divided by) of each.
        manipulability_at: M at positions (n,) rad; None for the surrogate.
    """

    setup: SutureSetup
    reward: Reward
    joints: SutureJoints
    margin: NDArray[np.float64]
    manipulability: NDArray[np.float64]
    source: str
    values: NDArray[np.float64]
    choice: NDArray[np.intp]
    scales: Scales
    manipulability_at: ManipulabilityAt | None = None

    def at(self, thetas_rad: ArrayLike) -> DexterityMap:
        """Return what sutures at other positions (n,) are worth, scaled as these are."""
        joints = suture_joints(self.setup, thetas_rad)
        return judged(self.setup, self.reward, joints, self.manipulability_at, self.source, self.scales)

    @property
    def thetas_rad(self) -> NDArray[np.float64]:
        """Return the positions (n,)."""
        return self.joints.thetas_rad

    @property
    def best(self) -> NDArray[np.float64]:
        """Return the dexterity (n,) in the better direction."""
        return np.take_along_axis(self.values, self.choice[None], 0)[0]

    @property
    def directions(self) -> NDArray[np.intp]:
        """Return the better direction (n,), as ``DIRECTIONS`` numbers them."""
        return np.array(DIRECTIONS)[self.choice]

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Return whether the suture (n,) in the better direction can be done."""
        return np.take_along_axis(self.joints.feasible, self.choice[None], 0)[0]

    def span(self, rewards: NDArray[np.float64]) -> tuple[float, float]:
        """Return the least and the largest of rewards (k,) and of all sutures that can be done, in either direction."""
        seen = np.append(rewards, self.values[self.joints.feasible])
        return float(seen.min()), float(seen.max())

    @property
    def switches_rad(self) -> NDArray[np.float64]:
        """Return the positions from which on the better direction is another than just before."""
        return self.thetas_rad[self.choice != np.roll(self.choice, 1)]


def joint_margin(arm: ArmModel, joints: SutureJoints, reward: Reward) -> NDArray[np.float64]:
    """Return Q (2, n) of both directions, before scaling; far below zero where the arm has no solution."""
    which = JOINTS[reward.joints]
    limit = ((arm.upper - arm.lower) / 2)[which]
    q = joints.q[:, :, joints.station] if reward.at == "stations" else joints.q
    largest = np.maximum(q.max(2) - arm.middle, arm.middle - q.min(2))[..., which]
    return np.nan_to_num(MARGINS[reward.margin](limit, largest), nan=NO_SOLUTION)


def surrogate_manipulability(joints: SutureJoints) -> NDArray[np.float64]:
    """Return the mean squared manipulability (n,) over both directions' primitives, for want of demonstrations.

    ``|J J^T|`` of the paper is the square of Yoshikawa's measure.
    """
    known = np.isfinite(joints.q)
    q = joints.q if known.all() else np.where(known, joints.q, 0.0)
    return (manipulability(joints.arm, q) ** 2).mean((0, 2))


def dexterity(
    setup: SutureSetup,
    reward: Reward | None = None,
    positions: int = 360,
    manipulability_at: ManipulabilityAt | None = None,
    source: str = "",
) -> DexterityMap:
    """Return what the sutures at evenly spaced positions are worth, in both directions.

    Args:
        setup: the geometry.
        reward: the measure; default: smallest normalised margin, lambda .75.
        positions: how many, from theta = 0 on.
        manipulability_at: M at positions (n,) rad, from demonstrations; default: the surrogate.
        source: where that M comes from, in words.
    """
    reward = reward or Reward()
    if not 4 <= positions <= 100_000:
        raise TrocarError(f"the number of positions is {positions}; give 4 to 100000")
    thetas = np.arange(positions, dtype=np.float64) * (2 * math.pi / positions)
    return judged(setup, reward, suture_joints(setup, thetas), manipulability_at, source)


def judged(
    setup: SutureSetup,
    reward: Reward,
    joints: SutureJoints,
    manipulability_at: ManipulabilityAt | None = None,
    source: str = "",
    scales: Scales | None = None,
) -> DexterityMap:
    """Return what sutures with these joints are worth; scaled as they require unless ``scales`` are given."""
    margin = joint_margin(setup.arm, joints, reward)
    given = manipulability_at(joints.thetas_rad) if manipulability_at else surrogate_manipulability(joints)
    source = source if manipulability_at else SURROGATE
    choice = np.argmax(margin - 1e9 * ~joints.feasible if reward.feasible_first else margin, axis=0)
    scale = SCALINGS[reward.scaling]
    scales = scales or (scale(np.take_along_axis(margin, choice[None], 0)[0]), scale(given))
    (q_less, q_unit), (m_less, m_unit) = scales
    values = reward.weight * (margin - q_less) / q_unit + (1.0 - reward.weight) * (given - m_less) / m_unit
    return DexterityMap(setup, reward, joints, margin, given, source, values, choice, scales, manipulability_at)
