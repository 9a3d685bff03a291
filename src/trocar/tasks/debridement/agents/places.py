"""Where grippers go: over and onto fragments, beside and over the receptacle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.perception.fragments import SeenFragment

TILT_RAD = np.radians(8.0)
"""The gripper leans back by this, so that the marks on its fingers face a camera at the front."""
TURNS_RAD = np.radians([0.0, -15.0, 15.0, -30.0, 30.0, -40.0, 40.0])
"""Rotations about the vertical that are tried; beyond them, marks turn away from the camera."""
BESIDE_M = 0.045  # where arms wait: this far from the receptacle's middle, to their side
OVER_M = 0.025  # where arms let go: this far from the receptacle's middle, to their side
NEAREST_M = 0.030  # no closer to the fragments than this, 5 mm inside the wall, if the first choice is out of reach
NEAR_M = tuple((out, back) for out in (0.0, 0.010, -0.012, 0.018, -0.025) for back in (0.0, -0.010, 0.010, -0.018))
"""Displacements, outwards and across, that are tried in turn if a place is out of reach."""
NEAR_RAD = (0.0, 0.35, -0.35)  # rotations of the gripper there, outwards, besides the present one
METRES_PER_RAD = 8.0e-3
"""Turning the gripper by another radian for a grasp costs as much as this many metres of additional fragment width
(assumed): with 1 rad/s^2, turning the wrist takes longer than moving the arm there."""
BEHIND_M = 0.030  # where arms wait: this far from the receptacle's middle, towards -y of the world
HIGHER_M = 0.015  # arms at rest are this much higher than when moving
ROOM_M = 1.0e-3  # least distance between the open jaws and a neighbouring fragment


@dataclass(frozen=True, eq=False)
class Grasp:
    """How one fragment is grasped."""

    T_world_above: SE3  # tip above it
    T_world_grasp: SE3  # tip with the fragment between the jaws
    open_rad: float  # jaw opening before the grasp
    crowded: int  # how many other fragments the jaws may catch


class Places:
    """Places in the world. The side of the left arm, at +x, is +1, that of the other one -1."""

    def __init__(self, T_world_table: SE3, T_world_receptacle: SE3, settings: Settings):
        self.table_m = float(T_world_table.translation_m[2])  # height of the work surface in the world
        self.receptacle_m = T_world_receptacle.translation_m  # the middle of its floor
        self.settings = settings

    def side(self, T_world_base: SE3) -> int:
        """Return on which side of the receptacle an arm stands."""
        return 1 if T_world_base.translation_m[0] > self.receptacle_m[0] else -1

    def hold(self, side: int, turn_rad: float) -> list[SE3]:
        """Return where an arm with this rotation may wait beside the receptacle, best first."""
        return self._around(side, turn_rad, BESIDE_M, -BEHIND_M, self.settings.hold_high_m)

    def home(self, side: int, turn_rad: float) -> list[SE3]:
        """Return where an arm may rest out of the other one's way."""
        return self._around(side, turn_rad, BESIDE_M, -BEHIND_M, self.settings.hold_high_m + HIGHER_M)

    def drop(self, side: int, turn_rad: float) -> list[SE3]:
        """Return where an arm may let go."""
        nearer_m = self.settings.drop_nearer_m
        return self._around(side, turn_rad, OVER_M, -nearer_m, self.settings.drop_high_m, -NEAREST_M)

    def _around(
        self, side: int, turn_rad: float, along_m: float, across_m: float, high_m: float, least_m: float = -np.inf
    ) -> list[SE3]:
        """Return poses at and near a place; bases and cables determine which of them are within reach."""
        turns = [side * turn for turn in NEAR_RAD]
        if self.settings.turns:
            turns.insert(0, float(np.clip(turn_rad, TURNS_RAD.min(), TURNS_RAD.max())))
        shifts = [np.array([side * (along_m + out), max(across_m + back, least_m), 0.0]) for out, back in NEAR_M]
        foot = np.array([*self.receptacle_m[:2], self.table_m + high_m])
        return [SE3.from_parts(_leaning(turn), foot + shift) for shift in shifts for turn in turns]

    def grasps(
        self, fragment: SeenFragment, others: Sequence[SeenFragment], arm: ArmModel, turn_rad: float, failures: int
    ) -> list[Grasp]:
        """Return grasps of a fragment beside others, the one least likely to catch a neighbour first.

        Of equally good ones, those near the present rotation of the arm's gripper about the vertical come first. After
        ``failures`` at the fragment, the next ones come first, and deeper.
        """
        turns = TURNS_RAD if self.settings.turns else TURNS_RAD[:1]
        heights_m = self.settings.ends_above_m
        above_m = heights_m[min(failures, len(heights_m) - 1)]
        found = [(float(turn), *self._grasp(fragment, others, arm, float(turn), above_m)) for turn in turns]
        found.sort(key=lambda way: (way[2].crowded, way[1] + METRES_PER_RAD * abs(way[0] - turn_rad)))
        grasps, again = [grasp for _, _, grasp in found], failures % len(found)
        return [*grasps[again:], *grasps[:again]]

    def _grasp(
        self, fragment: SeenFragment, others: Sequence[SeenFragment], arm: ArmModel, turn_rad: float, above_m: float
    ) -> tuple[float, Grasp]:
        """Return the width of the fragment between the jaws, and the grasp with this turn and height of their ends."""
        s, finger_m = self.settings, arm.instrument.finger_length_m
        R = _leaning(turn_rad)
        back = R.matrix[:, 2]
        rise = (fragment.p_world_m[2] - self.table_m - above_m) / back[2]
        ends = fragment.p_world_m - rise * back
        tip = ends + (finger_m - arm.tip_length_m) * back
        off, (long, short) = fragment.yaw_rad - turn_rad, fragment.extent_m
        width = float(np.hypot(long * np.cos(off), short * np.sin(off)))  # along the direction in which jaws close
        open_rad = s.open_rad
        if s.hug_m > 0:
            open_rad = min(open_rad, 2 * np.arcsin(min(1.0, (width + s.hug_m) / (2 * finger_m))))
        gap = 2 * finger_m * np.sin(open_rad / 2)
        crowded = sum(_within(fragment, other, turn_rad, gap, arm) for other in others)
        above = tip + s.above_m * back
        return width, Grasp(SE3.from_parts(R, above), SE3.from_parts(R, tip), float(open_rad), crowded)


def _leaning(turn_rad: float) -> SO3:
    """Return the rotation of a gripper that points down, leaning back, turned about the vertical."""
    return SO3.axis("z", turn_rad) @ SO3.axis("x", TILT_RAD)


def raised(T_world_tip: SE3, by_m: float) -> SE3:
    """Return a pose higher up."""
    return SE3.from_parts(T_world_tip.rotation, T_world_tip.translation_m + [0.0, 0.0, by_m])


def _within(fragment: SeenFragment, other: SeenFragment, turn_rad: float, gap_m: float, arm: ArmModel) -> bool:
    """Return whether jaws that close on a fragment may touch another one."""
    away: NDArray[np.float64] = SO3.axis("z", -turn_rad).apply(other.p_world_m - fragment.p_world_m)
    reach = 0.5 * float(np.mean(other.extent_m)) + ROOM_M
    shape = arm.instrument
    along = 0.5 * gap_m + shape.finger_base_m + reach
    return bool(abs(away[0]) < along and abs(away[1]) < 0.5 * shape.finger_width_m + reach)
