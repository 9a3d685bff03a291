"""Distances between two moving arms and the blocks that they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, fk
from trocar.arms.solids import solid_radii_m
from trocar.geometry import SE3
from trocar.geometry.capsules import segment_distances_m
from trocar.motion import MovingArm
from trocar.tasks.peg_transfer.shapes import Block

NEVER = (inf, inf)
LAYERS = 3
"""Heights at which the sides of a held block are modelled as capsules."""


@dataclass(frozen=True, eq=False)
class Body:
    """A moving arm, and the block in its jaws.

    Attributes:
        arm: on its trajectory.
        T_tip_block: pose of the block in the jaws; None if they are empty.
        block: its shape.
    """

    arm: MovingArm
    T_tip_block: SE3 | None
    block: Block

    def empty(self) -> Body:
        """Return the same without the block."""
        return replace(self, T_tip_block=None)

    def ends_m(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ends of all capsules in the world at the times (n,): (n, k, 2, 3) m."""
        parts = self.arm.ends_m(t_s)
        if self.T_tip_block is None:
            return parts
        T_world_tip = self.arm.T_world_base @ fk(self.arm.model, self.arm.joints(t_s))
        edges = self.T_tip_block.apply(_edges_m(self.block).reshape(-1, 3))
        R, t = T_world_tip.matrix[:, :3, :3], T_world_tip.matrix[:, None, :3, 3]
        placed = edges @ np.swapaxes(R, -1, -2) + t
        return np.concatenate([parts, placed.reshape(len(t_s), -1, 2, 3)], axis=1)

    @property
    def radii_m(self) -> NDArray[np.float64]:
        """Return the capsules' radii (k,)."""
        radii = solid_radii_m(self.arm.model)
        if self.T_tip_block is None:
            return radii
        return np.concatenate([radii, np.full(3 * LAYERS, self.block.corner_radius_m)])


def _edges_m(block: Block) -> NDArray[np.float64]:
    """Return the sides of a block between its corners' circles, at some heights: (9, 2, 3) in its frame."""
    corners = block.corners_m()
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    inset = block.corner_radius_m / 2
    heights = np.linspace(inset, block.height_m - inset, LAYERS)
    return np.concatenate([sides + [0.0, 0.0, z] for z in heights])


def distances_m(a: Body, a_s: NDArray[np.float64], b: Body, b_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance (n,) of two bodies, one at the times ``a_s`` (n,), the other at ``b_s`` (n,)."""
    return _gaps_m(a.ends_m(a_s), a.radii_m, b.ends_m(b_s), b.radii_m)


def min_delay_s(
    mover: Body,
    other: Body,
    now_s: float,
    margin_m: float,
    delays_s: Sequence[float],
    meets_s: tuple[float, float] = NEVER,
    step_s: float = 0.04,
) -> float | None:
    """Return the first of several delays after which a body may start; None if none of them will do.

    Sampled only: the caller checks the chosen motion between the samples too.

    Args:
        mover: the body that waits; its motion starts at 0 of its arm's own clock.
        other: the body to avoid; its clock is the cell's.
        now_s: the cell's clock.
        margin_m: to keep.
        delays_s: to try, in order.
        meets_s: interval of its motion in which the mover may touch the other's block.
        step_s: between samples.
    """
    lasting_s = mover.arm.trajectory.duration_s
    until_s = max(other.arm.end_s - now_s, 0.0)
    own_s = np.append(np.arange(0.0, lasting_s, step_s), lasting_s)
    ends = mover.ends_m(own_s)
    for delay_s in delays_s:
        last_s = max(lasting_s + delay_s, until_s)
        times = np.append(np.arange(0.0, last_s, step_s), last_s)
        index = np.clip(np.searchsorted(own_s, times - delay_s - 1e-9), 0, len(own_s) - 1)
        theirs = other.ends_m(now_s + times)
        apart = (times < delay_s + meets_s[0]) | (times >= delay_s + meets_s[1])
        arm = slice(len(SOLIDS))
        gaps = _gaps_m(ends[index[apart]], mover.radii_m, theirs[apart], other.radii_m)
        met = _gaps_m(ends[index[~apart]], mover.radii_m, theirs[~apart, arm], other.radii_m[arm])
        if min(gaps.min(initial=inf), met.min(initial=inf)) >= margin_m:
            return delay_s
    return None


def _gaps_m(
    p: NDArray[np.float64], p_radii: NDArray[np.float64], q: NDArray[np.float64], q_radii: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b = p[:, :, None], q[:, None]
    apart = segment_distances_m(a[..., 0, :], a[..., 1, :], b[..., 0, :], b[..., 1, :])
    return (apart - p_radii[:, None] - q_radii).min(axis=(1, 2))
