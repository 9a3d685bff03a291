"""Records what the arms and bodies of a simulated cell do, tick by tick."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.cell import Robot
from trocar.geometry import SE3, SO3
from trocar.replay import Solid
from trocar.sim.contacts import Collision
from trocar.sim.record import Record
from trocar.sim.world import World

VISIBLE_GROUPS = (0, 1, 2)


class Recorder:
    """Samples a world and its robot at each tick.

    Attributes:
        desired_of: the outermost robot, whose set-points are what the script asked for.
    """

    def __init__(self, world: World, robot: Robot):
        self._world, self._robot = world, robot
        self.desired_of: Robot = robot
        self._times: list[float] = []
        self._free: list[NDArray[np.float64]] = []
        self._rows: dict[str, dict[str, list[NDArray[np.float64]]]] = {
            name: {kind: [] for kind in ("desired", "commanded", "measured", "true")} for name in world.arm_names
        }

    def observe(self, time_s: float) -> None:
        """Take one sample."""
        world = self._world
        self._times.append(time_s)
        self._free.append(world.free_poses().copy())
        for name, rows in self._rows.items():
            reading, jaw = self._robot.read(name), world.jaw_rad(name)
            rows["desired"].append(np.append(self.desired_of.setpoint(name).q, jaw))
            rows["commanded"].append(np.append(self._robot.setpoint(name).q, jaw))
            rows["measured"].append(np.append(reading.q, reading.jaw_rad))
            rows["true"].append(np.append(world.joints(name), jaw))

    def record(self, collisions: tuple[Collision, ...]) -> Record:
        """Return the record so far."""
        poses = np.array(self._free).reshape(len(self._times), -1, 7)
        joints = self.joints("true")
        cell = self._world.cell
        return Record(
            times_s=np.array(self._times),
            joints=joints,
            T_world_body={
                body: SE3.from_parts(SO3.from_quaternion(poses[:, k, 3:]), poses[:, k, :3])
                for k, body in enumerate(self._world.free_bodies)
            },
            T_world_tip={
                name: cell.T_world_base[name] @ fk(arm, joints[name][:, :6]) for name, arm in cell.arms.items()
            },
            collisions=collisions,
        )

    def joints(self, kind: str) -> dict[str, NDArray[np.float64]]:
        """Return (n, 7) joints and jaw of each arm: ``desired``, ``commanded``, ``measured`` or ``true``."""
        return {name: np.array(rows[kind]).reshape(-1, 7) for name, rows in self._rows.items()}

    def free_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return positions and quaternions wxyz (n, 7) of each free body."""
        poses = np.array(self._free).reshape(len(self._times), -1, 7)
        return {body: poses[:, k] for k, body in enumerate(self._world.free_bodies)}


def solids_of(world: World) -> tuple[Solid, ...]:
    """Return everything visible in a world, except planes."""
    model, found = world.model, []
    for g in range(model.ngeom):
        geom = model.geom(g)
        shape = _SHAPES.get(int(geom.type[0]))
        if shape is None or int(geom.group[0]) not in VISIBLE_GROUPS:
            continue
        T = SE3.from_parts(SO3.from_quaternion(geom.quat), geom.pos)
        body = model.body(int(geom.bodyid[0])).name
        vertices = _vertices(model, int(geom.dataid[0])) if shape == "hull" else np.zeros((0, 3))
        size = tuple(geom.size[: _SIZES[shape]].tolist())
        found.append(Solid(body, shape, size, T, tuple(geom.rgba.tolist()), vertices))  # type: ignore[arg-type]
    return tuple(found)


def fixed_poses(world: World) -> dict[str, SE3]:
    """Return the poses of the bodies that are welded to the world, including the world itself."""
    fixed = [b for b in range(world.model.nbody) if world.model.body_weldid[b] == 0]
    return {world.model.body(b).name: world.pose(world.model.body(b).name) for b in fixed}


def _vertices(model: mujoco.MjModel, mesh: int) -> NDArray[np.float64]:
    """Return the corners (n, 3) of a mesh's convex hull in the geom's frame."""
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    return model.mesh_vert[start : start + count].astype(np.float64)


_SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_MESH): "hull",
}
_SIZES = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "hull": 0}
