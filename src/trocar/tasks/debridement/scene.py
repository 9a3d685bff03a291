"""Fragments of foam on a plane work surface, which may look like tissue, and a receptacle: simulator truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3, TURN
from trocar.tasks.debridement.goals import Receptacle, Workspace

HALF_M = (0.16, 0.13)  # half the sides of the covered area round the table's origin
KINDS = {
    "organ": (7, (0.020, 0.045), (0.6, 1.0), (0.62, 0.44, 0.33)),
    "fat": (16, (0.005, 0.014), (0.5, 1.0), (0.72, 0.63, 0.44)),
    "film": (10, (0.012, 0.030), (0.3, 0.7), (0.70, 0.60, 0.50)),
    "vein": (9, (0.020, 0.045), (0.05, 0.09), (0.34, 0.29, 0.46)),
}
"""Kinds of patches: how many, longest half axis in m, its ratio to the other one, linear colour. None is as red as a
fragment or as saturated as the marks of a gripper: hues of 20 to 45 and 260 deg, all of them pale
(``trocar.perception.color``)."""
GROUND = (0.66, 0.50, 0.39)  # colour of the area between patches
PROUD_M = 0.6e-3  # maximum height of patches; fragments lie on the plane, and are 8 to 12 mm high
SEGMENTS = 20  # number of corners of a patch's outline
SHADE = 0.08  # standard deviation of the brightness from patch to patch


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat mound that collides with nothing."""

    half_m: NDArray[np.float64]  # (3,) half axes, and height
    T_world_patch: SE3  # pose of its foot
    color: tuple[float, float, float]  # linear RGB in [0, 1]

    def corners_m(self) -> NDArray[np.float64]:
        """Return the corners (n, 3) of its convex hull in its frame."""
        angles = np.linspace(0.0, TURN, SEGMENTS, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(SEGMENTS)], axis=-1)
        return np.concatenate([ring, [0.8, 0.8, 0.0] * ring + [0.0, 0.0, 1.0]]) * self.half_m


def lay_tissue(T_world_table: SE3, rng: np.random.Generator) -> tuple[Patch, ...]:
    """Return random patches of flesh, fat, film and veins."""
    found = []
    for count, longest, ratio, color in KINDS.values():
        for _ in range(count):
            length = rng.uniform(*longest)
            half = np.array([length, length * rng.uniform(*ratio), PROUD_M * rng.uniform(0.5, 1.0)])
            place = np.append(rng.uniform(-1.0, 1.0, 2) * HALF_M, 0.0)
            turn = SO3.axis("z", rng.uniform(0.0, TURN))
            shade = float(np.clip(1.0 + SHADE * rng.standard_normal(), 0.8, 1.2))
            r, g, b = (shade * part for part in color)
            found.append(Patch(half, T_world_table @ SE3.from_parts(turn, place), (r, g, b)))
    return tuple(found)


LENGTH_M, WIDTH_M, HEIGHT_M = (0.010, 0.016), (0.008, 0.012), (0.008, 0.012)
"""Smallest and largest extents of a fragment, an irregular piece of foam rubber. The sizes are assumed: jaws that open
by 22 mm can take such a piece with a tip that is 5 mm off, and 3.5 % of the paper's grasps
failed. The paper also allowed errors of 8 mm in height, with which fingers would hardly hold lower pieces."""
CORNERS = 14  # number of random corners; about ten of them are on the hull
DENSITY_KG_M3 = (150.0, 270.0)  # range of densities; a fragment then weighs .05 to .2 g (assumed)
CLING_SHARE = 0.25  # share of fragments that are charged (assumed: occasional static cling, Kehoe 2014, VI)
CLING_N = (0.2e-3, 1.5e-3)  # force with which a charged fragment clings to a finger; .1 g weigh 1 mN (assumed)
GAP_M = 0.5e-3  # minimum gap between fragments
SHIFT_M, TURN_RAD = 1.5e-3, np.radians(1.5)  # error with which a person places the receptacle
ABOVE_M = 0.2e-3  # height above the work surface from which fragments are dropped


@dataclass(frozen=True, eq=False)
class Fragment:
    """One piece of foam."""

    vertices_m: NDArray[np.float64]  # (n, 3) corners of its convex hull; the origin is its centre of mass
    T_world_fragment: SE3  # where it is dropped
    density_kg_m3: float  # of the foam
    cling_n: float  # force of static cling to a finger that touches it

    @property
    def reach_m(self) -> float:
        """Return the radius of the circle about its origin that encloses it, seen from above."""
        return float(np.linalg.norm(self.T_world_fragment.rotation.apply(self.vertices_m)[:, :2], axis=-1).max())


@dataclass(frozen=True, eq=False)
class DebridementScene:
    """The objects on the work surface in one trial."""

    T_world_table: SE3  # the work surface: z up
    T_world_receptacle: SE3  # true pose of the receptacle
    receptacle: Receptacle  # its shape
    fragments: tuple[Fragment, ...]  # in any order
    tissue: tuple[Patch, ...] = ()  # patches on the work surface, if it looks like tissue
    p_world_eyes_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) the cameras' eyes


def lay_out(
    T_world_table: SE3, T_world_receptacle: SE3, workspace: Workspace, rng: np.random.Generator, backdrop: str = "plain"
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
        lay_tissue(T_world_table, rng) if backdrop == "tissue" else (),
    )


def _fragment(T_world_table: SE3, workspace: Workspace, rng: np.random.Generator) -> Fragment:
    """Return a piece with a flat bottom, somewhere in the region; its origin is its centre of mass."""
    from scipy.spatial import ConvexHull  # slow to import; help of the task does not need it

    size = np.array([rng.uniform(*extent) for extent in (LENGTH_M, WIDTH_M, HEIGHT_M)])
    directions = rng.standard_normal((CORNERS, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    corners = directions * rng.uniform(0.8, 1.0, (CORNERS, 1))
    bottom = corners[:, 2] < -0.3
    corners[bottom, 2] = -0.6  # pieces are cut flat at the bottom, not torn, so they do not roll
    corners *= size / np.ptp(corners, axis=0)
    corners = corners[ConvexHull(corners).vertices]
    middle = corners.mean(axis=0)
    faces = corners[ConvexHull(corners).simplices] - middle  # the bases of tetrahedra whose apex is the middle
    volumes = np.abs(np.linalg.det(faces))
    corners -= middle + (volumes[:, None] * faces.sum(axis=1) / 4).sum(axis=0) / volumes.sum()
    place = rng.uniform(*np.array(workspace.region_m))
    height = float(T_world_table.translation_m[2]) - corners[:, 2].min() + ABOVE_M
    turn = SO3.axis("z", rng.uniform(0.0, TURN))
    cling = rng.uniform(*CLING_N) if rng.uniform() < CLING_SHARE else 0.0
    return Fragment(corners, SE3.from_parts(turn, [*place, height]), rng.uniform(*DENSITY_KG_M3), cling)


def _apart(one: Fragment, other: Fragment) -> bool:
    away = one.T_world_fragment.translation_m[:2] - other.T_world_fragment.translation_m[:2]
    return float(np.linalg.norm(away)) > one.reach_m + other.reach_m + GAP_M
