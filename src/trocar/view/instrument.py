"""An instrument drawn from its arm's model at given joints, where no simulator gives the poses of its bodies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from trocar.arms import ArmModel, frames
from trocar.arms.solids import CARBON, parts_of
from trocar.geometry import SE3, SO3
from trocar.view.mesh import hull, part_mesh
from trocar.view.stage import Rgb

if TYPE_CHECKING:
    from viser import SceneApi

STEEL: Rgb = (170, 176, 184)
DARK: Rgb = (92, 98, 106)
LINKS = (4, 5, 6)
"""Links that carry solids: roll, wrist pitch, wrist yaw."""
FINGERS = {"left": 1, "right": -1}
"""Each finger's side of the closing plane."""


class Instrument:
    """The solids of an instrument: nodes ``NAME/4``, ``/5``, ``/6`` in the frames of links, ``NAME/left``, ``/right``.

    Args:
        scene: of the page.
        name: of the node above them.
        arm: model of its arm.
        shaft: colour of the shaft.
        steel: colour of all else.
        how: viser's options for all meshes, such as ``opacity``.

    Attributes:
        links: nodes by the numbers of the links.
        fingers: nodes by their sides.
    """

    def __init__(
        self, scene: SceneApi, name: str, arm: ArmModel, shaft: Rgb = DARK, steel: Rgb = STEEL, **how: Any
    ) -> None:
        self._arm, self._root = arm, scene.add_frame(name, show_axes=False)
        self.links = {link: scene.add_frame(f"{name}/{link}", show_axes=False) for link in LINKS}
        for part in parts_of(arm):
            drawn, colour = part_mesh(part), shaft if part.rgb == CARBON else steel
            scene.add_mesh_simple(f"{name}/{part.link}/{part.name}", drawn.vertices_m, drawn.faces, color=colour, **how)
        self.fingers: dict[str, Any] = {}
        for finger, side in FINGERS.items():
            drawn = hull(arm.instrument.finger_m(side))
            self.fingers[finger] = scene.add_mesh_simple(
                f"{name}/{finger}", drawn.vertices_m, drawn.faces, color=steel, **how
            )

    def show(self, T_world_base: SE3, q: ArrayLike, jaw_rad: float) -> None:
        """Draw the instrument at these joints (6,), with jaws open by this angle."""
        T_world_link = T_world_base @ frames(self._arm, q)
        for link, node in self.links.items():
            put(node, T_world_link[link])
        for finger, side in FINGERS.items():  # at rest it points along y of the last link, and turns about its z
            turn = SO3.axis("z", 0.5 * (math.pi + side * jaw_rad))
            put(self.fingers[finger], T_world_link[LINKS[-1]] @ SE3.from_parts(turn))

    def remove(self) -> None:
        """Remove it from the scene."""
        self._root.remove()


def put(node: Any, T: SE3) -> None:
    """Set the pose of a scene's node in its parent."""
    node.wxyz, node.position = T.rotation.as_quaternion(), T.translation_m
