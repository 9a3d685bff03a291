"""Work surface, receptacle and fragments in MJCF."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from scipy.spatial import ConvexHull

from trocar.geometry import SE3, SO3
from trocar.sim.elements import NOTHING, add, placed, scene_bits, text
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

DRY = {"priority": "2", "friction": text(DRY_FRICTION)}


def add_workspace(world: Element, assets: Element, scene: DebridementScene) -> None:
    """Add the work surface, the receptacle, and the fragments as free bodies."""
    for name, (grain, wet, sharp) in FINISHES.items():
        add(assets, "material", name=name, roughness=text(grain), specular=text(wet), shininess=text(sharp))
    _add_table(world, scene)
    _add_tissue(world, assets, scene)
    _add_receptacle(world, scene)
    _add_fragments(world, assets, scene)


def _add_table(world: Element, scene: DebridementScene) -> None:
    add(
        world,
        "geom",
        name="table",
        type="plane",
        size="0.5 0.5 0.01",
        rgba=text((*(GROUND if scene.tissue else WHITE_SURFACE), 1)),
        material="paper",
        **DRY,
        **placed(scene.T_world_table),
        **scene_bits(),
    )


def _add_tissue(world: Element, assets: Element, scene: DebridementScene) -> None:
    if not scene.tissue:
        return
    body = add(world, "body", name="tissue")
    for number, patch in enumerate(scene.tissue):
        add(assets, "mesh", name=f"tissue{number}", vertex=text(patch.corners_m()))
        add(
            body,
            "geom",
            name=f"tissue{number}",
            type="mesh",
            mesh=f"tissue{number}",
            rgba=text((*patch.color, 1)),
            material="flesh",
            **placed(patch.T_world_patch),
            **NOTHING,
        )


def _add_receptacle(world: Element, scene: DebridementScene) -> None:
    body = add(world, "body", name="receptacle", **placed(scene.T_world_receptacle))
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
    for name, (size, place) in sides.items():
        add(
            body,
            "geom",
            name=f"receptacle_{name}",
            type="box",
            size=text(size),
            rgba=text((*GREY_BOX, 1)),
            **DRY,
            material="plastic",
            **placed(SE3.from_parts(SO3.identity(), place)),
            **scene_bits(),
        )


def _add_fragments(world: Element, assets: Element, scene: DebridementScene) -> None:
    for number, fragment in enumerate(scene.fragments):
        name = f"fragment{number}"
        add(assets, "mesh", name=name, vertex=text(fragment.vertices_m))
        body = add(world, "body", name=name, **placed(fragment.T_world_fragment))
        add(body, "freejoint", name=name)
        add(
            body,
            "geom",
            name=name,
            type="mesh",
            mesh=name,
            density=text(fragment.density_kg_m3),
            rgba=text((*RED_FOAM, 1)),
            material="wet foam",
            **_foam(fragment),
            **scene_bits(),
        )


def _foam(fragment: Fragment) -> dict[str, str]:
    """Return the attributes of a geom of foam, as soft as foam is under fingers and under other foam.

    MuJoCo's contacts are as stiff as the lighter body is heavy, ``d / (1 - d) m / t^2`` with impedance d and time
    constant t. Solving for d makes foam equally soft in heavy and light pieces, and neither bursts out of the jaws.
    """
    mass = ConvexHull(fragment.vertices_m).volume * fragment.density_kg_m3
    ratio = FOAM_N_M * CONTACT_S**2 / mass
    impedance = min(ratio / (1.0 + ratio), FOAM_STRONGEST)
    reach = CLING_REACH_M if fragment.cling_n else 0.0
    return {
        "solmix": text(FOAM_WEIGHT),
        "condim": "6",
        "friction": text(FOAM_FRICTION),
        "solref": text((CONTACT_S, 1.0)),
        "solimp": text((impedance, impedance, 1e-3)),
        "margin": text(reach),
        "gap": text(reach),
    }
