"""The bodies of an arm in motion and their chord errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product
from math import factorial

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, wrist_depth_m
from trocar.arms.solids import SOLIDS, solid_radii_m
from trocar.geometry.capsules import Capsules
from trocar.motion.moving_arm import MovingArm
from trocar.motion.obstacles import Obstacle, stacked

INSERTION = 2
"""Index of the joint that slides; all axes before it and the roll after it pass through the remote centre."""


def greatest_accelerations(
    arm: MovingArm, begin_s: NDArray[np.float64], end_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return bounds on the acceleration of every point of the instrument's capsules: (n, 4) m/s^2.

    Over an interval of length h between two samples, a point is never further than ``h^2 / 8`` times this from the
    straight line between its sampled positions, so nothing is hidden between samples.

    With ``l_k`` the greatest distance of the point from the axis of joint k (1 for the joint that slides), each
    joint adds ``l_k (|a_k| + |v_k| (|v_k| + 2 sum of |v_j| over the joints j before it))``, where only revolute joints
    count among the velocities in brackets, because they rotate the motion of the joints after them.

    Args:
        arm: on its trajectory.
        begin_s: (n,) starts of the intervals; none holds a knot of the trajectory inside.
        end_s: (n,) their ends.
    """
    middle, half = (begin_s + end_s) / 2, (end_s - begin_s)[:, None] / 2
    speed, push = _greatest_rates(arm, middle, half)
    turning = speed.copy()
    turning[:, INSERTION] = 0.0
    before = np.cumsum(turning, axis=1) - turning
    depth = np.abs(wrist_depth_m(arm.model, arm.joints(middle)))
    levers = _levers(arm.model, depth, speed[:, INSERTION] * half[:, 0])
    return np.einsum("nkj,nj->nk", levers, push + speed * (turning + 2 * before))


def _greatest_rates(
    arm: MovingArm, middle_s: NDArray[np.float64], half_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return bounds (n, 6) of the joints' speeds and accelerations over intervals, from finite Taylor series.

    Between two knots a trajectory is a polynomial, so the series about the middle ends at its degree.
    """
    orders = [np.abs(arm.joints(middle_s, order)) for order in range(1, len(arm.trajectory.coefficients))]
    factors = [half_s**k / factorial(k) for k in range(len(orders))]
    still = np.zeros((len(middle_s), len(arm.model.joints)))
    speed = sum((f * order for f, order in zip(factors, orders, strict=True)), still)
    push = sum((f * order for f, order in zip(factors, orders[1:], strict=False)), still)
    return speed, push


def _levers(arm: ArmModel, depth_m: NDArray[np.float64], slid_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the greatest distances of the capsules' points from the joints' axes over intervals: (n, 4, 6).

    The axes of yaw, pitch and roll pass through the remote centre, and the shaft lies on the axis of the roll.

    Args:
        arm: whose instrument.
        depth_m: (n,) of the wrist beyond the remote centre, in the middle.
        slid_m: (n,) how far the insertion can move from there.
    """
    wrist, finger = arm.wrist_length_m, arm.instrument.finger_length_m
    lower = depth_m + slid_m
    upper = np.abs(arm.instrument.shaft_length_m - depth_m) + slid_m
    levers = np.zeros((len(depth_m), len(SOLIDS), len(arm.joints)))
    levers[:, :, INSERTION] = 1.0
    for k, reach_m in enumerate((0.0, wrist, wrist + finger, wrist + finger)):  # from the wrist's pitch axis
        levers[:, k, :INSERTION] = (np.maximum(lower, upper) if k == 0 else lower + reach_m)[:, None]
        levers[:, k, 3:5] = reach_m
    levers[:, 2:, 5] = finger
    return levers


@dataclass(frozen=True, eq=False)
class Bodies:
    """The capsules of moving arms, then those of obstacles, and which pairs of them count.

    Attributes:
        movers: the arms, four capsules each.
        still: the obstacles.
        names: of every capsule, as in ``"psm1 left finger"``.
        radii_m: (bodies,).
        pairs: (pairs, 2) indices of bodies.
        owners: name of the arm that each of the movers' capsules belongs to.
    """

    movers: tuple[MovingArm, ...]
    still: Capsules
    names: tuple[str, ...]
    radii_m: NDArray[np.float64]
    pairs: NDArray[np.intp]
    owners: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, arms: Mapping[str, MovingArm], others: Mapping[str, MovingArm], obstacles: Mapping[str, Obstacle]
    ) -> Bodies:
        """Return the bodies; pairs are of two planned arms, or of a planned arm and another arm or an obstacle."""
        movers = (*arms.values(), *others.values())
        still = stacked(obstacles)
        names = [f"{name} {solid}" for name in (*arms, *others) for solid in SOLIDS] + list(obstacles)
        radii = [solid_radii_m(arm.model) for arm in movers]
        groups = [range(len(SOLIDS) * k, len(SOLIDS) * (k + 1)) for k in range(len(movers))]
        groups += [range(k, k + 1) for k in range(len(SOLIDS) * len(movers), len(names))]
        meeting = (pair for pair in combinations(range(len(groups)), 2) if pair[0] < len(arms))
        pairs = [both for a, b in meeting for both in product(groups[a], groups[b])]
        return cls(
            movers,
            still,
            tuple(names),
            np.concatenate([*radii, still.radii_m]),
            np.array(pairs, dtype=np.intp).reshape(-1, 2),
            tuple(name for name in (*arms, *others) for _ in SOLIDS),
        )

    def arms_of(self, pair: NDArray[np.intp]) -> tuple[str, ...]:
        """Return the names of the arms to which two bodies belong."""
        return tuple(self.owners[body] for body in pair if body < len(self.owners))

    def ends_m(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return both ends of every capsule in the world at the times (n,): (n, bodies, 2, 3) m."""
        still = np.broadcast_to(self.still.ends_m, (len(t_s), *self.still.ends_m.shape))
        return np.concatenate([*(arm.ends_m(t_s) for arm in self.movers), still], axis=1)

    def accelerations(self, begin_s: NDArray[np.float64], end_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return bounds on the acceleration of every point of every capsule over intervals: (n, bodies) m/s^2."""
        still = np.zeros((len(begin_s), len(self.still.radii_m)))
        return np.concatenate([*(greatest_accelerations(arm, begin_s, end_s) for arm in self.movers), still], axis=1)
