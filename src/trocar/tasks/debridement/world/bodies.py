"""Work surface, receptacle and fragments as bodies of the simulator."""

from __future__ import annotations

from typing import Any

import mujoco
from mujoco import mjtGeom
from scipy.spatial import ConvexHull

from trocar.geometry import SE3, SO3
from trocar.sim.spec import INTANGIBLE, SOLID, digits, placed
from trocar.tasks.debridement.scene import GROUND, DebridementScene, Fragment

RED_FOAM = (0.62, 0.05, 0.05)
WHITE_SURFACE = (0.75, 0.75, 0.74)
GREY_BOX = (0.30, 0.31, 0.33)
FINISHES = {
    "paper": (0.05, 0.0, 0.0),
    "plastic": (0.05, 0.0, 0.0),
    "wet foam": (0.12, 0.7, 0.5),
    "flesh": (0.10, 0.3, 0.4),
}
"""Grain, brightness and sharpness of wet spots (``trocar.sim.appearance``) by material (assumed)."""
FLOOR_M = 0.001
"""Thickness of the receptacle's floor."""

FOAM_N_M = 2500.0
"""Stiffness of foam under one finger (assumed): that of 65 mm^2 of foam rubber of .3 MPa, 8 mm thick; the jaws' 1.7 N
sink in by .7 mm on each side."""
JAW_FRICTION = 1.5, 0.003, 0.0015
"""Friction of foam under a finger: sliding, including the hold of the jaws' teeth that sink in; lengths in m against
turning and rolling, for the patch of 2 mm radius that 1 mm of indentation makes (assumed)."""
FOAM_FRICTION = 0.9, 0.002, 0.0005
"""The same for foam on foam (assumed)."""
DRY_FRICTION = 0.6, 0.002, 0.0001
"""The same for foam or steel on the work surface and the receptacle, which determine these contacts (assumed)."""
FOAM_WEIGHT = 1e6
"""Weight that makes foam, not steel, determine the softness of their contact; of two frictions MuJoCo takes the larger
one."""
FOAM_STRONGEST = 0.9995
"""Maximum impedance of a contact, which MuJoCo requires to stay below 1."""
CONTACT_S = 0.003
"""Time constant of foam's contacts: MuJoCo's steps of 1 ms are stable from .002 s on."""
CLING_REACH_M = 0.3e-3
"""A charged fragment clings to a finger that it touched until it is this far away."""

DRY = {"priority": 2, "friction": DRY_FRICTION}


def add_workspace(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    """Add the work surface, the receptacle, and the fragments as free bodies."""
    for name, (grain, wet, sharp) in FINISHES.items():
        spec.add_material(name=name, roughness=grain, specular=wet, shininess=sharp)
    _add_table(spec, scene)
    _add_tissue(spec, scene)
    _add_receptacle(spec, scene)
    _add_fragments(spec, scene)


def _add_table(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    rgb = GROUND if scene.tissue else WHITE_SURFACE
    plane = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "rgba": (*rgb, 1), "material": "paper"}
    spec.worldbody.add_geom(name="table", **plane, **DRY, **placed(scene.T_world_table), **SOLID)


def _add_tissue(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    if not scene.tissue:
        return
    body = spec.worldbody.add_body(name="tissue")
    for number, patch in enumerate(scene.tissue):
        name = f"tissue{number}"
        spec.add_mesh(name=name, uservert=digits(patch.corners_m()).ravel())
        shape = {"type": mjtGeom.mjGEOM_MESH, "meshname": name, "rgba": (*patch.color, 1), "material": "flesh"}
        body.add_geom(name=name, **shape, **placed(patch.T_world_patch), **INTANGIBLE)


def _add_receptacle(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    body = spec.worldbody.add_body(name="receptacle", **placed(scene.T_world_receptacle))
    shape = scene.receptacle
    length, width = shape.size_m
    half, wall = 0.5 * shape.height_m, shape.wall_m
    sides = {
        "floor": ((length / 2 + wall, width / 2 + wall, FLOOR_M / 2), (0.0, 0.0, FLOOR_M / 2)),
        "left": ((wall / 2, width / 2 + wall, half), ((length + wall) / 2, 0.0, half)),
        "right": ((wall / 2, width / 2 + wall, half), (-(length + wall) / 2, 0.0, half)),
        "front": ((length / 2 + wall, wall / 2, half), (0.0, (width + wall) / 2, half)),
        "back": ((length / 2 + wall, wall / 2, half), (0.0, -(width + wall) / 2, half)),
    }
    look = {"type": mjtGeom.mjGEOM_BOX, "rgba": (*GREY_BOX, 1), "material": "plastic"}
    for name, (size, place) in sides.items():
        at = placed(SE3.from_parts(SO3.identity(), place))
        body.add_geom(name=f"receptacle_{name}", size=digits(size), **look, **DRY, **at, **SOLID)


def _add_fragments(spec: mujoco.MjSpec, scene: DebridementScene) -> None:
    for number, fragment in enumerate(scene.fragments):
        name = f"fragment{number}"
        spec.add_mesh(name=name, uservert=digits(fragment.vertices_m).ravel())
        body = spec.worldbody.add_body(name=name, **placed(fragment.T_world_fragment))
        body.add_freejoint(name=name)
        body.add_geom(
            name=name,
            type=mjtGeom.mjGEOM_MESH,
            meshname=name,
            density=digits(fragment.density_kg_m3),
            rgba=(*RED_FOAM, 1),
            material="wet foam",
            **_foam(fragment),
            **SOLID,
        )


def _foam(fragment: Fragment) -> dict[str, Any]:
    """Return the attributes of a geom of foam, as soft as foam is under fingers and under other foam.

    MuJoCo's contacts are as stiff as the lighter body is heavy, ``d / (1 - d) m / t^2`` with impedance d and time
    constant t. Solving for d makes foam equally soft in heavy and light pieces, and neither bursts out of the jaws.
    """
    mass = ConvexHull(fragment.vertices_m).volume * fragment.density_kg_m3
    ratio = FOAM_N_M * CONTACT_S**2 / mass
    impedance = min(ratio / (1.0 + ratio), FOAM_STRONGEST)
    reach = CLING_REACH_M if fragment.cling_n else 0.0
    return {
        "solmix": FOAM_WEIGHT,
        "condim": 6,
        "friction": FOAM_FRICTION,
        "solref": (CONTACT_S, 1.0),
        "solimp": digits((impedance, impedance, 1e-3, 0.5, 2.0)),
        "margin": reach,
        "gap": reach,
    }
