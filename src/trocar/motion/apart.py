"""A quick proof that arms stay apart: they were known to be far from each other, and have not moved far since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from math import inf

import numpy as np

from trocar.arms.solids import solid_radii_m
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.motion.bodies import MovingArm, greatest_displacement_m


@dataclass(frozen=True, eq=False)
class Apart:
    """How far apart arms were at one moment.

    ``swept_clearance`` tells how close arms come, which takes milliseconds. A stream of short motions asks for that 30
    times a second; as long as the arms are far apart, what is known of one moment answers for all motions nearby.

    Attributes:
        q: joints (6,) of each arm then, by name.
        jaw_rad: opening of its jaws then, by name.
        distance_m: least distance between any two of the arms then; infinite for one arm.
    """

    q: Mapping[str, Array]
    jaw_rad: Mapping[str, float]
    distance_m: float

    @staticmethod
    def at(arms: Mapping[str, MovingArm], time_s: float) -> Apart:
        """Return how far apart the arms are at this time of their clock."""
        solids = [Capsules(arm.ends_m(time_s), solid_radii_m(arm.model)) for arm in arms.values()]
        distances_m = [float(capsule_distances_m(*two).min()) for two in combinations(solids, 2)]
        q = {name: arm.joints(time_s) for name, arm in arms.items()}
        return Apart(q, {name: arm.jaw_rad for name, arm in arms.items()}, min(distances_m, default=inf))

    def least_m(self, arms: Mapping[str, MovingArm]) -> float:
        """Return a lower bound of the distance between any two of these arms on their motions; it may be below 0.

        Args:
            arms: the same ones, by name.
        """
        moved_m = sorted(
            greatest_displacement_m(arm, self.q[name])
            + arm.model.instrument.finger_length_m * float(np.abs(arm.jaw_rad - self.jaw_rad[name])) / 2
            for name, arm in arms.items()
        )
        return self.distance_m - sum(moved_m[-2:])
