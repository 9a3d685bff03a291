"""The constraints on a path, linearised about it: distances, ranges, facing; one row per place and constraint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.geometry.capsules import cross
from trocar.motion.arm_motion import JOINTS, ArmMotion
from trocar.motion.convex.scene import Distances

Array = NDArray[np.float64]

FACING_M = 0.05
"""Weight of the cosine of an angle relative to distances: the displacement of a mark this far from the tip."""
FACED = 0.3
"""A facing constraint counts if its cosine is within this of the limit."""
INSIDE = 5e-4
"""Margin (rad, m) of the control points to the ends of the joints' ranges."""
RANGE_M = 0.1
"""Weight of a joint outside its range (rad, m) relative to distances."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``room + slope . (basis dx)``, each to be at least 0, where dx (controls, joints) moves the control points.

    Attributes:
        room: (rows,) what is left now, m; below 0 where a row is violated.
        slope: (rows, joints) by the joints.
        basis: (rows, controls) of the control points.
    """

    room: Array
    slope: Array
    basis: Array

    @staticmethod
    def joined(parts: list[Rows]) -> Rows:
        """Return the rows of all parts."""
        room, slope, basis = zip(*((part.room, part.slope, part.basis) for part in parts), strict=True)
        return Rows(np.concatenate(room), np.concatenate(slope), np.concatenate(basis))

    def after(self, change: Array) -> Array:
        """Return what is left of the rows (rows,) if the control points move by (controls, joints)."""
        return self.room + np.einsum("rj,rj->r", self.slope, self.basis @ change)


def distance_rows(distances: Distances, wanted_m: Array, basis: Array, watched_m: float) -> Rows:
    """Return the rows of all pairs that are closer than required, or not much further apart.

    Args:
        distances: at n places.
        wanted_m: (n,) least distance at each.
        basis: (n, controls) of the places.
        watched_m: how much further apart a pair may be and still count.
    """
    room = distances.distance_m - wanted_m[:, None]
    place, pair = np.nonzero(room < watched_m)
    return Rows(room[place, pair], distances.gradients(place, pair), basis[place])


def range_rows(arms: tuple[ArmMotion, ...], control: Array, slack: float) -> Rows:
    """Return the rows of control points (controls, joints) near the end of a joint's range or beyond it.

    The path lies within the hull of its control points, separately for each joint.
    """
    lower, upper = (np.concatenate([getattr(arm.model, name) for arm in arms]) for name in ("lower", "upper"))
    extent = upper - lower
    inside = INSIDE - slack * extent
    rooms = np.stack([control - lower - inside, upper - inside - control])
    rooms[:, [0, -1]] = np.inf
    side, row, joint = np.nonzero(rooms < 0.1 * extent)
    slope = np.zeros((len(row), control.shape[1]))
    slope[np.arange(len(row)), joint] = RANGE_M * np.where(side == 0, 1.0, -1.0)
    return Rows(RANGE_M * rooms[side, row, joint], slope, np.eye(len(control))[row])


def facing_rows(distances: Distances, spare_rad: Array, basis: Array) -> Rows:
    """Return the rows of the facing constraints that are violated or nearly so.

    Args:
        distances: at n places.
        spare_rad: (n,) margin to be kept to the limit.
        basis: (n, controls) of the places.
    """
    joints = distances.q.shape[1]
    parts = [Rows(np.zeros(0), np.zeros((0, joints)), np.zeros((0, basis.shape[1])))]
    for k, arm in enumerate(distances.scene.arms):
        if arm.facing is None:
            continue
        columns = slice(JOINTS * k, JOINTS * (k + 1))
        T_world_tip = arm.T_world_base @ fk(arm.model, distances.q[:, columns])
        axis, tip = T_world_tip.matrix[:, :3, :3] @ arm.facing.axis, T_world_tip.matrix[:, :3, 3]
        way = arm.facing.towards_m - tip
        away = np.sqrt(np.einsum("ni,ni->n", way, way))[:, None]
        way /= away
        cosines = np.einsum("ni,ni->n", axis, way)
        room = FACING_M * (cosines - np.cos(np.maximum(arm.facing.max_rad - spare_rad, 1e-3)))
        near = np.flatnonzero(room < FACING_M * FACED)
        if not len(near):
            continue
        axis, way = axis[near], way[near]
        screws = distances.screws[k]
        swing = np.einsum("rji,ri->rj", screws.turning[near], cross(axis, way))
        aside = (cosines[near, None] * way - axis) / away[near]
        slopes = np.zeros((len(near), joints))
        slopes[:, columns] = FACING_M * (swing + screws.slopes(near, tip[near], aside))
        parts.append(Rows(room[near], slopes, basis[near]))
    return Rows.joined(parts)


def taper(curve_shares: Array, margin: float, share: float = 0.1) -> Array:
    """Return a margin (n,) that grows from 0 at both ends of the path: a start may stand as near as is allowed."""
    return margin * np.clip(np.minimum(curve_shares, 1 - curve_shares) / share, 0.0, 1.0)
