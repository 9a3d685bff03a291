"""The simulated world of the sutures: phantom, needle, the person who loads it, and the referee who watches it.

No agent may import this.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle, pairwise
from typing import Any

import mujoco
import numpy as np
import trio
from mujoco import mjtGeom
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.geometry import SE3, SO3, TURN
from trocar.sim.record import Record
from trocar.sim.spec import INTANGIBLE, SOLID, digits, placed
from trocar.sim.world import TaskWorld, World
from trocar.tasks.suture.scene import SutureScene
from trocar.tasks.suture.score import NeedleTruth
from trocar.tasks.suture.stand import PHANTOM_M, STAND_M, T_stand_needle

PHANTOM_RGB = (0.86, 0.64, 0.55)
NEEDLE_RGB = (0.75, 0.77, 0.80)
MARK_RGB = (0.20, 0.25, 0.55)
MARKS = 72
"""Number of dashes that draw the circle on the phantom."""
STEEL_KG_M3 = 7900.0
ASIDE_M = (0.075, 0.060, 0.010)
"""Where a person keeps the needle until the agent asks for it, in the circle's frame."""
LOADING_S = 1.0
"""Time that a person takes to load the needle (assumed; reported separately)."""
DRAG_NS_M = 20.0
"""Viscous drag on the needle's centre while phantom or stand hold it: .2 N at 10 mm/s (assumed). There are no tissue
mechanics: the phantom bears the needle's weight and drags on it. A fallen needle that is touched has the same drag."""
APPARENT_KG = 0.1
"""Inertia added to the needle in every direction, so that contacts of a .2 g body are as stiff as those of the jaws;
driving a needle is quasi-static. A fallen needle that nobody touches has no added inertia."""
UNHELD_S = 0.1
"""A needle falls when nothing has held or touched it for this long; closing jaws lose contact for moments."""
GROUND_BIT = 2**30
"""Contact bit with which a fallen needle meets phantom, stand and table; otherwise it passes through them."""
GROUND = {"contype": 0, "conaffinity": GROUND_BIT, "friction": (0.6, 0.002, 0.0001), "solref": (0.002, 1.0)}
"""Attributes of the geoms on which a fallen needle comes to rest (friction assumed)."""
LET_GO_N = 1.0
"""Jaws grip the needle if each finger presses with more than this force; a person then releases it."""


def add_phantom(spec: mujoco.MjSpec, scene: SutureScene) -> None:
    """Add phantom, table, stand, the circle's marks and the needle; only a fallen needle touches the first three."""
    width, depth, thickness = PHANTOM_M
    world = spec.worldbody
    phantom = world.add_body(name="phantom", **placed(scene.T_world_circle))
    half = (width / 2, depth / 2, thickness / 2)
    box = {"type": mjtGeom.mjGEOM_BOX, "size": digits(half), "pos": digits((0, 0, -half[2]))}
    phantom.add_geom(name="phantom", rgba=(*PHANTOM_RGB, 1), **box, **GROUND)
    below = scene.T_world_circle.apply([0.0, 0.0, -thickness])[2] - 0.002
    plane = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "pos": digits((0, 0, below))}
    world.add_geom(name="table", **plane, **GROUND)
    dash = {"type": mjtGeom.mjGEOM_BOX, "size": (0.0003, 0.0008, 0.00005), "rgba": (*MARK_RGB, 1)}
    for index, angle in enumerate(np.linspace(0.0, TURN, MARKS, endpoint=False)):
        at = SE3.from_parts(SO3.axis("z", angle)) @ SE3.from_parts(translation_m=[scene.circle_radius_m, 0.0, 0.0])
        phantom.add_geom(name=f"mark{index}", **dash, **placed(at), **INTANGIBLE)
    if scene.T_world_stand is not None:
        stand = world.add_body(name="stand", **placed(scene.T_world_stand))
        half = (STAND_M[0] / 2, STAND_M[1] / 2, STAND_M[2] / 2)
        box = {"type": mjtGeom.mjGEOM_BOX, "size": digits(half), "pos": digits((0, 0, -half[2]))}
        stand.add_geom(name="stand", rgba=(*PHANTOM_RGB, 1), **box, **GROUND)
    needle = world.add_body(name="needle", **placed(scene.T_world_circle @ SE3.from_parts(translation_m=ASIDE_M)))
    needle.add_freejoint(name="needle")
    wire = {"type": mjtGeom.mjGEOM_CAPSULE, "size": digits((scene.needle.wire_m / 2, 0, 0)), "rgba": (*NEEDLE_RGB, 1)}
    for index, (start, end) in enumerate(pairwise(scene.wire_points_m)):
        needle.add_geom(name=f"needle_{index}", fromto=digits((*start, *end)), density=STEEL_KG_M3, **wire, **SOLID)


class SutureWorld(TaskWorld):
    """World of the suture task, in which jaws, phantom, stand or a person hold the needle.

    A needle that nothing holds falls, and comes to rest on phantom, stand or table. Nothing else touches these.

    Args:
        scene: the scene.
        arm: name of the arm that drives the needle.
        second: name of the arm that pulls it through and hands it back; empty: a person pulls it out and loads it.

    Attributes:
        in_hand: whether a person holds the needle.
    """

    def __init__(self, scene: SutureScene, arm: str, second: str = ""):
        self._scene, self._arm, self._second = scene, arm, second
        self._loads = cycle(scene.T_needle_loaded)
        self._noted_gripped: list[bool] = []
        self._noted_in_hand: list[bool] = []

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add phantom, circle and needle."""
        add_phantom(spec, self._scene)

    def start(self, world: World) -> None:
        """Put the needle into a person's hand, or into its stand."""
        self._world = world
        self._circle_world, stand = self._scene.T_world_circle.inverse().matrix, self._scene.T_world_stand
        self._stand_world = None if stand is None else stand.inverse().matrix
        self._wire_m = self._scene.wire_points_m
        joint = world.model.joint("needle")
        self._body = world.model.body("needle").id
        self._qpos = slice(joint.qposadr[0], joint.qposadr[0] + 7)
        self._dof = slice(joint.dofadr[0], joint.dofadr[0] + 6)
        turning = self._scene.needle.radius_m**2
        share = np.array([1.0, 1.0, 1.0, turning, turning, turning])
        self._apparent = APPARENT_KG * share
        world.model.dof_armature[self._dof] = self._apparent
        mujoco.mj_setConst(world.model, world.data)
        self._drag = DRAG_NS_M * share
        self._is_needle = np.isin(np.arange(world.model.ngeom), world.geoms("needle_"))
        self._of_arm, self._fallen, self._held_s = world.geom_arm >= 0, False, world.data.time
        self.in_hand, self._hand = True, world.data.qpos[self._qpos].copy()
        if self._scene.T_world_stand is not None:
            T = self._scene.T_world_stand @ T_stand_needle(self._scene.needle) @ next(self._loads)
            self.in_hand, world.data.qpos[self._qpos] = False, _pose7(T)

    def act(self) -> None:
        """Hold the needle during the next physics steps, unless jaws hold it or it falls."""
        data = self._world.data
        if self.in_hand and self._gripped(self._arm):
            self.in_hand = False
        if self.in_hand:
            data.qpos[self._qpos] = self._hand
            data.qvel[self._dof] = 0.0
        touched = self._touched()
        if self._fallen:  # a fallen needle that dips into the ground is not held there: jaws or a person must take it
            self._fallen = not (self.in_hand or any(self._gripped(arm) for arm in self._world.arms))
        held = not self._fallen and (self.in_hand or self._inserted() or self._stands())
        if held or touched:
            self._held_s = data.time
        self._fallen |= data.time - self._held_s > UNHELD_S
        model = self._world.model
        model.dof_damping[self._dof] = self._drag if held or (self._fallen and touched) else 0.0
        model.body_gravcomp[self._body] = float(held)
        model.dof_armature[self._dof] = 0.0 if self._fallen and not touched else self._apparent
        meets = SOLID["contype"] | (GROUND_BIT if self._fallen else 0)
        model.geom_contype[self._is_needle] = model.body_contype[self._body] = meets

    def observe(self, time_s: float) -> None:
        """Note who holds the needle."""
        del time_s
        gripped, in_hand = self._gripped(self._arm), self.in_hand
        if self._second:
            by_second = self._gripped(self._second)
            gripped &= not by_second
            in_hand = not self._inserted() and (by_second or self._stands())
        self._noted_gripped.append(gripped)
        self._noted_in_hand.append(in_hand)

    def truth(self, record: Record) -> NeedleTruth:
        """Return needle and tip in the circle's frame, and who held the needle."""
        T_circle_world = self._scene.T_world_circle.inverse()
        return NeedleTruth(
            times_s=record.times_s,
            T_circle_needle=T_circle_world @ record.T_world_body["needle"],
            T_circle_tip=T_circle_world @ record.T_world_tip[self._arm],
            gripped=np.array(self._noted_gripped),
            in_hand=np.array(self._noted_in_hand),
            p_needle_tip_m=self._scene.needle.p_tip_m,
            by_two_arms=bool(self._second),
        )

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return the circle's true pose."""
        del record
        return {"T_world_circle": self._scene.T_world_circle.matrix}

    def assistants(self) -> Mapping[str, Any]:
        """Return the person who loads the needle at the jaws' true pose; nobody if two arms sew."""
        return {} if self._second else {"load needle": self._load}

    async def _load(self, arm: str) -> None:
        """Put the needle between the open jaws, about in the agreed grasp, and hold it there until they close."""
        await trio.sleep(LOADING_S)
        world = self._world
        T_world_tip = world.T_world_base[arm] @ fk(world.models[arm], world.joints(arm))
        T_world_needle = T_world_tip @ self._scene.T_tip_needle @ next(self._loads)
        self._hand = _pose7(T_world_needle)
        self.in_hand = True

    def _inserted(self) -> bool:
        """Return whether a part of the wire is in the phantom."""
        return self._within(PHANTOM_M, self._circle_world)

    def _stands(self) -> bool:
        """Return whether a part of the wire is in the stand's foam."""
        return self._stand_world is not None and self._within(STAND_M, self._stand_world)

    def _touched(self) -> bool:
        """Return whether an instrument touches the needle."""
        pairs = self._world.data.contact.geom[: self._world.data.ncon]
        return bool((self._is_needle[pairs].any(1) & self._of_arm[pairs].any(1)).any())

    def _within(self, size_m: tuple[float, float, float], T_block_world: NDArray[np.float64]) -> bool:
        """Return whether a part of the wire is in a block, whose frame is in the middle of its top, z up."""
        p, (width, depth, height) = self._wire_in(T_block_world), size_m
        inside = (np.abs(p[:, 0]) < width / 2) & (np.abs(p[:, 1]) < depth / 2) & (p[:, 2] < 0) & (p[:, 2] > -height)
        return bool(inside.any())

    def _wire_in(self, T_frame_world: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the wire's points (n, 3) in a frame, given as a matrix."""
        qpos, R_world_needle = self._world.data.qpos[self._qpos], np.empty(9)
        mujoco.mju_quat2Mat(R_world_needle, qpos[3:])
        world_m = self._wire_m @ R_world_needle.reshape(3, 3).T + qpos[:3]
        return world_m @ T_frame_world[:3, :3].T + T_frame_world[:3, 3]

    def _gripped(self, arm: str) -> bool:
        """Return whether both fingers of an arm press on the needle."""
        data = self._world.data
        pairs = data.contact.geom[: data.ncon]
        needle = np.asarray(self._is_needle[pairs].any(1))
        if not needle.any():
            return False
        return all(self._press_n(finger, pairs, needle) > LET_GO_N for finger in self._world.arms[arm].fingers)

    def _press_n(self, finger: int, pairs: NDArray[np.int32], needle: NDArray[np.bool_]) -> float:
        """Return the force with which a finger presses on the needle."""
        total, force = 0.0, np.zeros(6)
        for contact in np.flatnonzero(needle & (pairs == finger).any(1)):
            mujoco.mj_contactForce(self._world.model, self._world.data, int(contact), force)
            total += force[0]
        return total


def _pose7(T: SE3) -> NDArray[np.float64]:
    """Return position and quaternion (7,) in MuJoCo's order."""
    return np.append(T.translation_m, T.rotation.as_quaternion())
