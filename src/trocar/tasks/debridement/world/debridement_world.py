"""The work surface in the simulator, and its referee, who sees everything and tells no agent."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.sim.record import CollidingPair, Record
from trocar.sim.world import TaskWorld, World
from trocar.tasks.debridement.scene import DebridementScene
from trocar.tasks.debridement.truth import DebridementTruth
from trocar.tasks.debridement.world.bodies import JAW_FRICTION, add_workspace
from trocar.tasks.debridement.world.fingers import NO_FINGER, Fingers
from trocar.tasks.debridement.world.looks import Looks

GRASP_PRESS_N = 2.0
"""Jaws that approach a fragment may brush the work surface with up to this force: an arm that yields 1 mm/N is 2 mm too
low then, which is the planned distance between the fingers' ends and the surface. More is a collision, as is any other
touch of the surface."""
GRASP_M = 0.030
"""Jaws approach a fragment if it is within this distance of their tip."""


class DebridementWorld(TaskWorld):
    """Fragments, receptacle, work surface. Arms that hit the last two count as collisions."""

    sleeps = True

    def __init__(self, scene: DebridementScene):
        self._scene = scene
        self._touched: list[NDArray[np.bool_]] = []
        self._held: list[NDArray[np.bool_]] = []

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add the work surface, the receptacle and the fragments."""
        add_workspace(spec, self._scene)

    def start(self, world: World) -> None:
        """Number the geoms of fragments, fingers and furniture; let the jaws' teeth hold foam."""
        fragments, self._world = self._scene.fragments, world
        self._fingers = Fingers(world, fragments)
        self._looks = Looks(world, [fragment.vertices_m for fragment in fragments], self._scene.p_world_eyes_m)
        world.model.geom_friction[self._fingers.finger != NO_FINGER] = JAW_FRICTION
        self._table = world.model.geom("table").id
        self._walls = set(world.geoms("receptacle").tolist())

    def act(self) -> None:
        """Let charged fragments cling to fingers."""
        self._fingers.pull()

    def observe(self, time_s: float) -> None:
        """Record which fragments each finger touches and, at intervals, which could be seen."""
        touched = self._fingers.touched()
        self._touched.append(np.any(touched, axis=1))
        self._held.append(self._fingers.held(touched))
        self._looks.observe(time_s)

    def collision(self, first: int, second: int) -> CollidingPair | None:
        """Return who collides if an arm touches the receptacle, or the work surface other than lightly in a grasp."""
        for geom, other in ((first, second), (second, first)):
            arm = int(self._world.geom_arm[geom])
            if arm >= 0 and other in self._walls:
                return CollidingPair(self._world.arm_names[arm], "arm", "receptacle")
            if arm >= 0 and other == self._table and not self._brushes(geom, first, second):
                return CollidingPair(self._world.arm_names[arm], "arm", "table")
        return None

    def _brushes(self, geom: int, first: int, second: int) -> bool:
        """Return whether a finger touches the work surface lightly while it approaches a fragment."""
        if self._fingers.finger[geom] == NO_FINGER:
            return False
        data, force = self._world.data, np.zeros(6)
        for contact in np.flatnonzero((data.contact.geom[: data.ncon] == (first, second)).all(axis=1)):
            mujoco.mj_contactForce(self._world.model, data, int(contact), force)
            if force[0] > GRASP_PRESS_N:
                return False
        away = self._world.free_poses()[:, :2] - data.geom_xpos[geom][:2]
        return bool((np.linalg.norm(away, axis=-1) < GRASP_M).any())

    def truth(self, record: Record) -> DebridementTruth:
        """Return where fragments and tips were, and when fragments were held."""
        scene, fragments = self._scene, self._scene.fragments
        poses = [record.T_world_body[f"fragment{k}"].matrix for k in range(len(fragments))]
        return DebridementTruth(
            times_s=record.times_s,
            T_world_fragments=SE3.unchecked(np.stack(poses, axis=1)),
            fragments_m=tuple(fragment.vertices_m for fragment in fragments),
            held_by=self._by_arm(self._held),
            touched_by=self._by_arm(self._touched),
            jaw_rad={name: joints[:, 6] for name, joints in record.joints.items()},
            T_world_tips=record.T_world_tip,
            T_world_receptacle=scene.T_world_receptacle,
            receptacle=scene.receptacle,
            table_z_m=float(scene.T_world_table.translation_m[2]),
            sights=self._looks.sights(),
        )

    def _by_arm(self, rows: list[NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
        """Return (n, fragments) for each arm, from (arms, fragments) per tick."""
        return dict(zip(self._world.arm_names, np.moveaxis(np.array(rows), 1, 0), strict=True))

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return the receptacle's true pose."""
        del record
        return {"T_world_receptacle": self._scene.T_world_receptacle.matrix}
