"""Which circles an arm can sew with a needle, by where its port stands: a map over the base's distance and height.

A circle can be sewn if the suture at every position is feasible in at least one direction. Rotating the base about the
circle's axis only rotates the positions, so distance and height describe a port; a body wall and a second port are
placed as for a base in the direction of x. In the middle of the arm's ranges the instrument points at the circle's
centre; several rotations about that line are tried. The primitive is scaled with the needle.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk
from trocar.geometry import SE3, SO3, TURN
from trocar.tasks.suture.needle import Needle
from trocar.tasks.suture.planning.primitive import jaws_above_m, suture_joints
from trocar.tasks.suture.planning.setup import Circle, Insertion, NeedleGrasp, Puller, SutureSetup, Wall

SIDEWAYS_M = np.linspace(0.0, 0.120, 9)
UP_M = np.linspace(0.060, 0.200, 8)
RADII_M = np.linspace(0.080, 0.015, 14)
"""Radii of the circles that are tried, the largest first."""
SPINS_RAD = np.arange(8) * (TURN / 8)
APPROACHES_RAD = np.radians([-30.0, -10.0, 10.0, 30.0, 50.0])
LEANS_RAD = np.radians([0.0, 15.0, 30.0, 45.0, 60.0])
BEHIND_RAD = math.radians(145.0)
"""The jaws hold the needle this far behind its tip, or as far as the last grasp allows; nearer they meet the tissue."""
TO_TAIL_RAD = math.radians(5.0)
STRAIGHT = Insertion().straight_m / Needle().radius_m
"""Ratio of the straight path to the needle's radius: the paper's, with the default needle."""
COARSE, FINE = 12, 72
"""Number of positions at which a setup is tested first, and then, if it passes, for good."""


@dataclass(frozen=True, eq=False)
class SetupMap:
    """Largest circle that an arm can sew with a needle, by the place of its base.

    Attributes:
        arm: the arm.
        needle: the needle.
        sideways_m: (x,) horizontal distance of the base from the circle's centre.
        up_m: (y,) its height.
        radius_m: (y, x) radius of the largest circle; 0: none of those that were tried.
        setups: setup of the largest circle at each place that has one, by (y, x).
    """

    arm: ArmModel
    needle: Needle
    sideways_m: NDArray[np.float64]
    up_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    setups: dict[tuple[int, int], SutureSetup]

    @property
    def best(self) -> SutureSetup | None:
        """Return the setup of the largest circle; of several the lowest, then the nearest. None if there is none."""
        if not self.setups:
            return None
        y, x = np.unravel_index(int(np.argmax(self.radius_m)), self.radius_m.shape)
        return self.setups[int(y), int(x)]


def setup_map(
    arm: ArmModel,
    needle: Needle,
    sideways_m: NDArray[np.float64] = SIDEWAYS_M,
    up_m: NDArray[np.float64] = UP_M,
    wall: Wall | None = None,
    puller: Puller | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SetupMap:
    """Return the map of an arm and a needle.

    Args:
        arm: the arm.
        needle: the needle.
        sideways_m: (x,) distances of the base.
        up_m: (y,) heights of the base.
        wall: the body wall; default: none.
        puller: the second arm's port; default: none.
        progress: called with the number of places done, and their number.
    """
    around = {"wall": wall or Wall(), "puller": puller or Puller()}
    grasped = [replace(setup, **around) for setup in grasps(arm, needle)]
    radius_m, setups = np.zeros((len(up_m), len(sideways_m))), {}
    places = list(itertools.product(range(len(up_m)), range(len(sideways_m))))
    for done, (y, x) in enumerate(places, start=1):
        found = _largest(grasped, float(sideways_m[x]), float(up_m[y]))
        if found:
            radius_m[y, x], setups[y, x] = found.circle.radius_m, found
        if progress:
            progress(done, len(places))
    return SetupMap(arm, needle, sideways_m, up_m, radius_m, setups)


def grasps(arm: ArmModel, needle: Needle) -> Iterator[SutureSetup]:
    """Yield setups in which flat jaws can hold the needle, stay above the tissue and bring the needle's tip out."""
    smallest = Circle(max(float(RADII_M.max()), 2 * needle.radius_m))
    for pushes in range(4):
        insertion = Insertion(straight_m=STRAIGHT * needle.radius_m, pushes=pushes)
        behind = min(BEHIND_RAD, needle.arc_rad - TO_TAIL_RAD - pushes * insertion.regrasp_rad)
        if behind <= 0:
            return
        setup = SutureSetup(arm, circle=smallest, needle=needle, grasp=NeedleGrasp(behind), insertion=insertion)
        if setup.comes_out:
            break
    else:
        return
    for approach, lean in itertools.product(APPROACHES_RAD.tolist(), LEANS_RAD.tolist()):
        held = replace(setup, grasp=NeedleGrasp(behind, approach, lean))
        if jaws_above_m(held) >= 0:
            yield held


def _largest(grasped: list[SutureSetup], sideways_m: float, up_m: float) -> SutureSetup | None:
    """Return the setup of the largest circle that can be sewn from a place; None if there is none."""
    place_m = np.array([sideways_m, 0.0, up_m])
    bases = _aimed(grasped[0].arm, place_m) if grasped and not grasped[0].wall.port_off_m(place_m) else []
    for radius_m in RADII_M.tolist():
        for base, setup in itertools.product(bases, grasped):
            if 2 * setup.needle.radius_m > radius_m:
                continue
            there = replace(setup, T_world_base=base, circle=Circle(radius_m))
            if all(_all_round(there, positions) for positions in (COARSE, FINE)):
                return there
    return None


def _aimed(arm: ArmModel, place_m: NDArray[np.float64]) -> list[SE3]:
    """Return bases at a place (3,) from which the instrument, in the middle of its ranges, points at the origin."""
    wanted = -place_m / np.linalg.norm(place_m)
    to_origin = SO3.between(fk(arm, arm.middle).translation_m, wanted)
    return [SE3.from_parts(SO3.exp(spin * wanted) @ to_origin, place_m) for spin in SPINS_RAD.tolist()]


def _all_round(setup: SutureSetup, positions: int) -> bool:
    """Return whether every one of so many positions can be sewn in one direction at least."""
    thetas = np.arange(positions) * (TURN / positions)
    return bool(suture_joints(setup, thetas).feasible.any(0).all())
