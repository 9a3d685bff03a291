"""Distances between two moving arms and what they hold, and how long one has to wait for the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, fk
from trocar.arms.solids import solid_radii_m
from trocar.geometry.capsules import Capsules, segment_distances_m
from trocar.motion import MovingArm

NEVER = (inf, inf)
"""An interval of a motion in which nothing may be touched."""


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A moving arm, and what it holds in its jaws.

    Attributes:
        arm: on its trajectory.
        held: solids in its jaws, in the frame of its tip; None: the jaws are empty.
    """

    arm: MovingArm
    held: Capsules | None = None

    def empty(self) -> MovingBody:
        """Return the same with empty jaws."""
        return replace(self, held=None)

    def ends_m(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ends of all capsules in the world at the times (n,): (n, k, 2, 3) m."""
        parts = self.arm.ends_m(t_s)
        if self.held is None:
            return parts
        T_world_tip = self.arm.T_world_base @ fk(self.arm.model, self.arm.joints(t_s))
        return np.concatenate([parts, self.held.moved(T_world_tip).ends_m], axis=1)

    @property
    def radii_m(self) -> NDArray[np.float64]:
        """Return the capsules' radii (k,)."""
        radii = solid_radii_m(self.arm.model)
        return radii if self.held is None else np.concatenate([radii, self.held.radii_m])


def distance_m(a: MovingBody, a_s: float, b: MovingBody, b_s: float) -> float:
    """Return the distance of two bodies, one at the time ``a_s`` of its clock, the other at ``b_s``."""
    ends = a.ends_m(np.array([a_s])), b.ends_m(np.array([b_s]))
    return float(_gaps_m(ends[0], a.radii_m, ends[1], b.radii_m)[0])


def min_delay_s(
    mover: MovingBody,
    other: MovingBody,
    now_s: float,
    margin_m: float,
    delays_s: Sequence[float],
    contact_s: tuple[float, float] = NEVER,
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
        contact_s: interval of its motion in which the mover may touch what the other one holds.
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
        apart = (times < delay_s + contact_s[0]) | (times >= delay_s + contact_s[1])
        arm = slice(len(SOLIDS))
        gaps = _gaps_m(ends[index[apart]], mover.radii_m, theirs[apart], other.radii_m)
        touching = _gaps_m(ends[index[~apart]], mover.radii_m, theirs[~apart, arm], other.radii_m[arm])
        if min(gaps.min(initial=inf), touching.min(initial=inf)) >= margin_m:
            return delay_s
    return None


def _gaps_m(
    p: NDArray[np.float64], p_radii: NDArray[np.float64], q: NDArray[np.float64], q_radii: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b = p[:, :, None], q[:, None]
    apart = segment_distances_m(a[..., 0, :], a[..., 1, :], b[..., 0, :], b[..., 1, :])
    return (apart - p_radii[:, None] - q_radii).min(axis=(1, 2))
