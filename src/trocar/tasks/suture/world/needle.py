"""A suture needle: its body in the simulator, and what holds it when the jaws do not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from mujoco import mjtGeom
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3, TURN
from trocar.sim.spec import INTANGIBLE, SOLID, digits, placed
from trocar.sim.world import World
from trocar.tasks.suture.scene import SutureScene

PHANTOM_RGB = (0.86, 0.64, 0.55)
NEEDLE_RGB = (0.75, 0.77, 0.80)
MARK_RGB = (0.20, 0.25, 0.55)
TABLE_RGB = (0.30, 0.33, 0.36)
MARKS = 72
"""Number of dashes with which the circle on the phantom is drawn."""

STEEL_KG_M3 = 7900.0
ASIDE_M = (0.075, 0.060, 0.010)
"""Where a person keeps the needle until the jaws ask for it, in the circle's frame."""


@dataclass(frozen=True)
class Tissue:
    """How the phantom holds a needle: it bears its weight and drags on it (assumed; there are no tissue mechanics).

    Attributes:
        drag_ns_m: viscous drag on the needle's centre while a part of it is below the surface: .2 N at 10 mm/s.
        apparent_kg: inertia added to the needle in every direction, so that the contacts of a .2 g body are as stiff as
            those of the jaws; driving a needle is quasi-static.
        let_go_n: a person releases the needle when each finger of the jaws presses with this force, so that they grip
            it.
    """

    drag_ns_m: float = 20.0
    apparent_kg: float = 0.1
    let_go_n: float = 1.0


def add_phantom(spec: mujoco.MjSpec, scene: SutureScene) -> None:
    """Add the phantom, visible but without collisions, the circle's marks, and the needle as a free body."""
    width, depth, thickness = scene.phantom_m
    world = spec.worldbody
    phantom = world.add_body(name="phantom", **placed(scene.T_world_circle))
    half = (width / 2, depth / 2, thickness / 2)
    box = {"type": mjtGeom.mjGEOM_BOX, "size": digits(half), "pos": digits((0, 0, -half[2]))}
    phantom.add_geom(name="phantom", rgba=(*PHANTOM_RGB, 1), **box, **INTANGIBLE)
    below = scene.T_world_circle.apply([0.0, 0.0, -thickness])[2] - 0.002
    plane = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "pos": digits((0, 0, below))}
    world.add_geom(name="table", **plane, **INTANGIBLE)
    dash = {"type": mjtGeom.mjGEOM_BOX, "size": (0.0003, 0.0008, 0.00005), "rgba": (*MARK_RGB, 1)}
    for index, angle in enumerate(np.linspace(0.0, TURN, MARKS, endpoint=False)):
        at = SE3.from_parts(SO3.axis("z", angle)) @ SE3.from_parts(translation_m=[scene.circle_radius_m, 0.0, 0.0])
        phantom.add_geom(name=f"mark{index}", **dash, **placed(at), **INTANGIBLE)
    needle = world.add_body(name="needle", **placed(scene.T_world_circle @ SE3.from_parts(translation_m=ASIDE_M)))
    needle.add_freejoint(name="needle")
    wire = {"type": mjtGeom.mjGEOM_CAPSULE, "size": digits((scene.needle.wire_m / 2, 0, 0)), "rgba": (*NEEDLE_RGB, 1)}
    for index, (start, end) in enumerate(pairwise(scene.wire_points_m)):
        needle.add_geom(name=f"needle_{index}", fromto=digits((*start, *end)), density=STEEL_KG_M3, **wire, **SOLID)


class HeldNeedle:
    """What holds the needle besides the jaws: a person's hand, or the phantom.

    Attributes:
        in_hand: whether a person holds it.
    """

    def __init__(self, world: World, scene: SutureScene, arm: str, tissue: Tissue | None = None):
        self._world = world
        self._up, self._height_m = np.split(scene.T_world_circle.inverse().matrix[2], [3])  # over the phantom
        self._wire_m = scene.wire_points_m
        self._tissue = tissue or Tissue()
        joint = world.model.joint("needle")
        self._body = world.model.body("needle").id
        self._qpos = slice(joint.qposadr[0], joint.qposadr[0] + 7)
        self._dof = slice(joint.dofadr[0], joint.dofadr[0] + 6)
        turning = scene.needle.radius_m**2
        share = np.array([1.0, 1.0, 1.0, turning, turning, turning])
        world.model.dof_armature[self._dof] = self._tissue.apparent_kg * share
        mujoco.mj_setConst(world.model, world.data)
        self._drag = self._tissue.drag_ns_m * share
        self._is_needle = np.isin(np.arange(world.model.ngeom), world.geoms("needle_"))
        self._fingers = world.arms[arm].fingers
        self.in_hand = True
        self._hand = world.data.qpos[self._qpos].copy()

    @property
    def inserted(self) -> bool:
        """Return whether a part of the wire is below the phantom's surface."""
        qpos, R_world_needle = self._world.data.qpos[self._qpos], np.empty(9)
        mujoco.mju_quat2Mat(R_world_needle, qpos[3:])
        heights_m = self._wire_m @ (self._up @ R_world_needle.reshape(3, 3)) + self._up @ qpos[:3] + self._height_m
        return bool((heights_m < 0.0).any())

    def give(self, T_world_needle: SE3) -> None:
        """Have a person take the needle from where it is and hold it here until both fingers press."""
        self._hand = np.append(T_world_needle.translation_m, T_world_needle.rotation.as_quaternion())
        self.in_hand = True

    def act(self) -> None:
        """Hold the needle for the next steps of the physics."""
        data = self._world.data
        if self.in_hand and self.gripped():
            self.in_hand = False
        if self.in_hand:
            data.qpos[self._qpos] = self._hand
            data.qvel[self._dof] = 0.0
        held = self.in_hand or self.inserted
        self._world.model.dof_damping[self._dof] = self._drag if held else 0.0
        self._world.model.body_gravcomp[self._body] = float(held)

    def gripped(self) -> bool:
        """Return whether both fingers of the arm press on the needle."""
        data = self._world.data
        pairs = data.contact.geom[: data.ncon]
        needle = np.asarray(self._is_needle[pairs].any(1))
        if not needle.any():
            return False
        return all(self._press_n(finger, pairs, needle) > self._tissue.let_go_n for finger in self._fingers)

    def _press_n(self, finger: int, pairs: NDArray[np.int32], needle: NDArray[np.bool_]) -> float:
        """Return the force with which a finger presses on the needle."""
        total, force = 0.0, np.zeros(6)
        for contact in np.flatnonzero(needle & (pairs == finger).any(1)):
            mujoco.mj_contactForce(self._world.model, self._world.data, int(contact), force)
            total += force[0]
        return total
