"""An instrument drawn from its arm's model at given joints, where no simulator gives the poses of its bodies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from trocar.arms import ArmModel, frames
from trocar.geometry import SE3, SO3
from trocar.view import mesh
from trocar.view.stage import Rgb

if TYPE_CHECKING:
    from viser import SceneApi

STEEL: Rgb = (170, 176, 184)
DARK: Rgb = (92, 98, 106)
FRAMES = {"shaft": 4, "wrist": 5, "jaws": 7}
"""Index in ``trocar.arms.frames`` of the frame in which each part is drawn."""
FINGERS = {"left": 0.5, "right": -0.5}
"""Each finger's share of the opening."""


class Instrument:
    """Shaft, wrist and fingers: nodes ``NAME/shaft``, ``NAME/wrist``, ``NAME/jaws/left``, ``NAME/jaws/right``.

    Args:
        scene: of the page.
        name: of the node above them.
        arm: model of its arm.
        shaft: colour of the shaft.
        steel: colour of wrist and fingers.
        how: viser's options for all meshes, such as ``opacity``.

    Attributes:
        parts: nodes by the names of the parts.
    """

    def __init__(
        self, scene: SceneApi, name: str, arm: ArmModel, shaft: Rgb = DARK, steel: Rgb = STEEL, **how: Any
    ) -> None:
        def add(part: str, drawn: mesh.Mesh, colour: Rgb) -> Any:
            return scene.add_mesh_simple(f"{name}/{part}", drawn.vertices_m, drawn.faces, color=colour, **how)

        self._arm, self._root = arm, scene.add_frame(name, show_axes=False)
        self.parts: dict[str, Any] = {
            "shaft": add("shaft", mesh.shaft(arm), shaft),
            "wrist": add("wrist", mesh.wrist_link(arm), steel),
            "jaws": scene.add_frame(f"{name}/jaws", show_axes=False),
            **{side: add(f"jaws/{side}", mesh.finger(arm), steel) for side in FINGERS},
        }

    def show(self, T_world_base: SE3, q: ArrayLike, jaw_rad: float) -> None:
        """Draw the instrument at these joints (6,), with jaws open by this angle."""
        T_world_frame = T_world_base @ frames(self._arm, q)
        for part, frame in FRAMES.items():
            put(self.parts[part], T_world_frame[frame])
        for side, share in FINGERS.items():
            half = SO3.identity() if share > 0 else SO3.axis("z", math.pi)
            turn = SO3.axis("y", -share * jaw_rad) @ half
            put(self.parts[side], SE3.from_parts(turn, [0.0, 0.0, self._arm.tip_length_m]))

    def remove(self) -> None:
        """Remove it from the scene."""
        self._root.remove()


def put(node: Any, T: SE3) -> None:
    """Set the pose of a scene's node in its parent."""
    node.wxyz, node.position = T.rotation.as_quaternion(), T.translation_m
