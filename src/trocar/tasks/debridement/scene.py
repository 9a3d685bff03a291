"""Fragments of foam on a plane work surface, and a receptacle: simulator truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3, TURN
from trocar.tasks.debridement.tissue import Patch, lay_tissue
from trocar.tasks.debridement.workspace import Receptacle, Workspace

LENGTH_M, WIDTH_M, HEIGHT_M = (0.010, 0.016), (0.008, 0.012), (0.008, 0.012)
"""Extents of a fragment, smallest and largest: small irregular pieces of foam rubber. Sizes are assumed: jaws that open
by 22 mm (facts/debridement.md) can take them if the tip is 5 mm off, and 3.5 % of the paper's grasps failed. The paper
also allowed a tip to be 8 mm off in height; fingers would hardly hold pieces lower than these."""
CORNERS = 14
"""Number of random corners; about ten of them are on the hull."""
DENSITY_KG_M3 = (150.0, 270.0)
"""Range of densities; a fragment then weighs .05 to .2 g (facts/debridement.md)."""
CLING_SHARE = 0.25
"""Share of fragments that are charged (assumed: occasional static cling, Kehoe 2014, VI)."""
CLING_N = (0.2e-3, 1.5e-3)
"""Force with which a charged fragment clings to a finger; .1 g weigh 1 mN (assumed)."""
GAP_M = 0.5e-3
"""Minimum gap between fragments."""
SHIFT_M, TURN_RAD = 1.5e-3, np.radians(1.5)
"""Error with which a person places the receptacle."""
ABOVE_M = 0.2e-3
"""Height above the work surface from which fragments are dropped."""


@dataclass(frozen=True, eq=False)
class Fragment:
    """One piece of foam.

    Attributes:
        vertices_m: (n, 3) corners of its convex hull in its frame, whose origin is its centre of mass.
        T_world_fragment: where it is dropped.
        density_kg_m3: of the foam.
        cling_n: force of static cling to a finger that touches it.
    """

    vertices_m: NDArray[np.float64]
    T_world_fragment: SE3
    density_kg_m3: float
    cling_n: float

    @property
    def reach_m(self) -> float:
        """Return the radius about its origin, seen from above, within which it lies."""
        return float(np.linalg.norm(self.T_world_fragment.rotation.apply(self.vertices_m)[:, :2], axis=-1).max())


@dataclass(frozen=True, eq=False)
class DebridementScene:
    """The objects on the work surface in one trial.

    Attributes:
        T_world_table: the work surface: z up.
        T_world_receptacle: true pose of the receptacle.
        receptacle: its shape.
        fragments: in any order.
        backdrop: what covers the work surface: ``plain`` or ``tissue``.
        tissue: patches on it, if it is tissue.
        p_world_eyes_m: (n, 3) positions of the cameras' eyes, from which the referee checks which fragments could be
            seen.
    """

    T_world_table: SE3
    T_world_receptacle: SE3
    receptacle: Receptacle
    fragments: tuple[Fragment, ...]
    backdrop: str = "plain"
    tissue: tuple[Patch, ...] = ()
    p_world_eyes_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))


def lay_out(
    T_world_table: SE3,
    T_world_receptacle: SE3,
    workspace: Workspace,
    rng: np.random.Generator,
    backdrop: str = "plain",
) -> DebridementScene:
    """Return a random scene: each fragment anywhere in the region where the previous ones left room."""
    shift = np.append(rng.uniform(-SHIFT_M, SHIFT_M, 2), 0.0)
    turn = SO3.axis("z", rng.uniform(-TURN_RAD, TURN_RAD))
    fragments: list[Fragment] = []
    while len(fragments) < workspace.fragments:
        fragment = _fragment(T_world_table, workspace, rng)
        if all(_apart(fragment, other) for other in fragments):
            fragments.append(fragment)
    return DebridementScene(
        T_world_table,
        T_world_receptacle @ SE3.from_parts(turn, shift),
        workspace.receptacle,
        tuple(fragments),
        backdrop,
        lay_tissue(T_world_table, rng) if backdrop == "tissue" else (),
    )


def _fragment(T_world_table: SE3, workspace: Workspace, rng: np.random.Generator) -> Fragment:
    """Return a piece with a flat bottom, somewhere in the region."""
    from scipy.spatial import ConvexHull  # slow to import; help of the task does not need it

    size = np.array([rng.uniform(*extent) for extent in (LENGTH_M, WIDTH_M, HEIGHT_M)])
    directions = rng.standard_normal((CORNERS, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    corners = directions * rng.uniform(0.8, 1.0, (CORNERS, 1))
    bottom = corners[:, 2] < -0.3
    corners[bottom, 2] = -0.6  # pieces are cut flat at the bottom, not torn, so they do not roll
    corners *= size / np.ptp(corners, axis=0)
    hull = ConvexHull(corners)
    corners = corners[hull.vertices]
    corners -= _centre(corners)
    place = rng.uniform(*np.array(workspace.region_m))
    height = float(T_world_table.translation_m[2]) - corners[:, 2].min() + ABOVE_M
    turn = SO3.axis("z", rng.uniform(0.0, TURN))
    cling = rng.uniform(*CLING_N) if rng.uniform() < CLING_SHARE else 0.0
    return Fragment(
        corners,
        SE3.from_parts(turn, [*place, height]),
        rng.uniform(*DENSITY_KG_M3),
        cling,
    )


def _centre(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the centre of mass (3,) of a convex hull, from the tetrahedra between its middle and its faces."""
    from scipy.spatial import ConvexHull

    hull, middle = ConvexHull(corners), corners.mean(axis=0)
    faces = corners[hull.simplices] - middle
    volumes = np.abs(np.linalg.det(faces))
    return middle + (volumes[:, None] * faces.sum(axis=1) / 4).sum(axis=0) / volumes.sum()


def _apart(one: Fragment, other: Fragment) -> bool:
    away = one.T_world_fragment.translation_m[:2] - other.T_world_fragment.translation_m[:2]
    return float(np.linalg.norm(away)) > one.reach_m + other.reach_m + GAP_M
