"""What happened in a simulated cell, tick by tick: arms, bodies, and collisions. Simulator truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import DTypeLike, NDArray

from trocar.arms import fk
from trocar.cell import Robot
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.replay import Solid
from trocar.sim.spec import SHAPES

if TYPE_CHECKING:
    from trocar.sim.world import World

KINDS = ("desired", "commanded", "measured", "true")
COLLISION_N = 0.5
"""A contact with no more force than this is not a collision; .5 N does not visibly bend a peg (assumed)."""
APART_S = 0.2
"""A contact that recurs within this time is the same collision."""
VISIBLE_GROUPS = (0, 1, 2)
FIRST_ROWS = 1024
"""Rows that fit before an array grows: ten seconds."""


class Rows:
    """Rows of one shape in an array that grows; what has been read of them stays as it is.

    Args:
        shape: of a row.
        dtype: of its items.
    """

    def __init__(self, *shape: int, dtype: DTypeLike = np.float64):
        self._all = np.empty((FIRST_ROWS, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, count: int = 1) -> NDArray[Any]:
        """Add rows, and return them to be written: (count, ...)."""
        first, self._count = self._count, self._count + count
        while self._count > len(self._all):
            self._all = np.concatenate([self._all, np.empty_like(self._all)])
        return self._all[first : self._count]

    def read(self, start: int = 0) -> NDArray[Any]:
        """Return the rows from ``start`` on, not to be written; -1 gives the last one."""
        rows = self._all[: self._count][start:]
        rows.flags.writeable = False
        return rows


class CollidingPair(NamedTuple):
    """The parts of a collision: name of the arm; ``arm`` or what the arm holds; the other arm or the object hit."""

    arm: str
    what: str
    against: str


@dataclass(frozen=True)
class Collision:
    """One collision of a ``CollidingPair``.

    Attributes:
        time_s: start on the trial's clock.
        end_s: end on the trial's clock.
        arm: as in the pair.
        what: as in the pair.
        against: as in the pair.
        force_n: largest force while it lasted.
        p_world_m: point of the largest force.
    """

    time_s: float
    end_s: float
    arm: str
    what: str
    against: str
    force_n: float
    p_world_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Record:
    """The true state at every tick.

    Attributes:
        times_s: (n,) times of the cell's clock, 100 Hz; the first is 0.
        joints: (n, 7) true joints and jaw opening of each arm, by name.
        T_world_body: (n,) true poses of the free bodies, by name.
        T_world_tip: (n,) true poses of the arms' tips, by name.
        collisions: all collisions, in order of time.
    """

    times_s: Array
    joints: Mapping[str, Array]
    T_world_body: Mapping[str, SE3]
    T_world_tip: Mapping[str, SE3]
    collisions: tuple[Collision, ...]


class Recorder:
    """Samples a world and its robot at each tick.

    Args:
        world: the world; simulator truth.
        robot: the guarded robot, whose set-points are the ``commanded`` joints.
        jaw_command_rad: returns the commanded opening of an arm's jaws.

    Attributes:
        desired_of: the outermost robot, whose set-points are the ``desired`` joints, which the script asked for.
    """

    def __init__(self, world: World, robot: Robot, jaw_command_rad: Callable[[str], float]):
        self._world, self._robot, self._jaw_command_rad = world, robot, jaw_command_rad
        self.desired_of: Robot = robot
        bodies = world.free_bodies
        self._times, self._free = Rows(), Rows(len(bodies), 7)
        self._joints = {name: {kind: Rows(7) for kind in KINDS} for name in world.arm_names}
        self._bodies = {body: Rows(4, 4) for body in bodies}
        self._tips = {name: Rows(4, 4) for name in world.arm_names}

    def observe(self, time_s: float) -> None:
        """Take one sample."""
        world = self._world
        self._times.add()[0] = time_s
        self._free.add()[0] = world.free_poses()
        for name, rows in self._joints.items():
            reading, jaw_rad = self._robot.read(name), self._jaw_command_rad(name)
            samples = (
                (self.desired_of.setpoint(name).q, jaw_rad),
                (self._robot.setpoint(name).q, jaw_rad),
                (reading.q, reading.jaw_rad),
                (world.joints(name), world.jaw_rad(name)),
            )
            for kind, (q, opening_rad) in zip(KINDS, samples, strict=True):
                row = rows[kind].add()[0]
                row[:6], row[6] = q, opening_rad

    def record(self, collisions: tuple[Collision, ...]) -> Record:
        """Return the record so far; poses are computed for the rows that are new since the last call."""
        for k, poses in enumerate(self._bodies.values()):
            new = self._free.read(len(poses))[:, k]
            poses.add(len(new))[:] = SE3.from_parts(SO3.from_quaternion(new[:, 3:]), new[:, :3]).matrix
        for name, poses in self._tips.items():
            new = self._joints[name]["true"].read(len(poses))
            poses.add(len(new))[:] = (self._world.T_world_base[name] @ fk(self._world.models[name], new[:, :6])).matrix
        return Record(
            self._times.read(),
            self.joints("true"),
            {body: SE3.unchecked(poses.read()) for body, poses in self._bodies.items()},
            {name: SE3.unchecked(poses.read()) for name, poses in self._tips.items()},
            collisions,
        )

    def joints(self, kind: str, start: int = 0) -> dict[str, Array]:
        """Return (n, 7) joints and jaw of each arm: ``desired``, ``commanded``, ``measured`` or ``true``."""
        return {name: rows[kind].read(start) for name, rows in self._joints.items()}

    def free_poses(self, start: int = 0) -> dict[str, Array]:
        """Return positions and quaternions wxyz (n, 7) of each free body."""
        poses = self._free.read(start)
        return {body: poses[:, k] for k, body in enumerate(self._world.free_bodies)}

    def arrays(self, start: int = 0) -> dict[str, Array]:
        """Return the arrays that every trial saves: joints of the arms and poses of free bodies at 100 Hz.

        ``start`` is the first row; -1 gives only the last one.
        """
        arrays = {f"{kind}_{name}": rows for kind in KINDS for name, rows in self.joints(kind, start).items()}
        return arrays | {f"body_{body}": rows for body, rows in self.free_poses(start).items()}


class ContactMonitor:
    """Collects collisions: contacts between two arms, and those of a task, if the task's ``counts`` accepts them."""

    def __init__(self, world: World):
        self._world = world
        self._last: dict[CollidingPair, Collision] = {}
        self._earlier: list[Collision] = []

    def observe(self, time_s: float) -> None:
        """Add the contacts of this tick."""
        world, data, names = self._world, self._world.data, self._world.arm_names
        pairs = data.contact.geom[: data.ncon]
        for contact in range(len(pairs)):
            first, second = int(pairs[contact, 0]), int(pairs[contact, 1])
            a, b = int(world.geom_arm[first]), int(world.geom_arm[second])
            between_arms = a >= 0 and b >= 0
            pair = CollidingPair(names[a], "arm", names[b]) if between_arms else world.task.collision(first, second)
            if pair is None:
                continue
            force = np.zeros(6)
            mujoco.mj_contactForce(world.model, data, contact, force)
            if force[0] > COLLISION_N and world.task.counts(pair, data.contact.frame[contact][:3]):
                x, y, z = np.round(data.contact.pos[contact], 6).tolist()
                self._add(pair, Collision(time_s, time_s, *pair, float(force[0]), (x, y, z)))

    def _add(self, pair: CollidingPair, now: Collision) -> None:
        """Prolong this pair's last collision, or begin another one if the pair was apart."""
        last = self._last.get(pair)
        if last is None or now.time_s - last.end_s > APART_S:
            self._earlier += [] if last is None else [last]
            self._last[pair] = now
        else:
            strongest = now if now.force_n > last.force_n else last
            self._last[pair] = replace(strongest, time_s=last.time_s, end_s=now.end_s)

    def collisions(self, after_s: float = -1.0, until_s: float = math.inf) -> tuple[Collision, ...]:
        """Return the collisions so far that began after ``after_s`` and not after ``until_s``, in order of time."""
        found = [
            replace(c, time_s=round(c.time_s, 6), end_s=round(c.end_s, 6), force_n=round(c.force_n, 3))
            for c in (*self._earlier, *self._last.values())
            if after_s < c.time_s <= until_s
        ]
        return tuple(sorted(found, key=lambda c: (c.time_s, c.arm, c.against)))


def solids_of(world: World) -> tuple[Solid, ...]:
    """Return everything visible in a world, except planes."""
    model, found = world.model, []
    for g in range(model.ngeom):
        geom = model.geom(g)
        shape = _SHAPES.get(int(geom.type[0]))
        if shape is None or int(geom.group[0]) not in VISIBLE_GROUPS:
            continue
        T = SE3.from_parts(SO3.from_quaternion(geom.quat), geom.pos)
        body, vertices = model.body(int(geom.bodyid[0])).name, np.zeros((0, 3))
        if shape == "hull":
            mesh = int(geom.dataid[0])
            start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            vertices = model.mesh_vert[start : start + count].astype(np.float64)
        size = tuple(geom.size[: _SIZES[shape]].tolist())
        found.append(Solid(body, shape, size, T, tuple(geom.rgba.tolist()), vertices))  # type: ignore[arg-type]
    return tuple(found)


def fixed_poses(world: World) -> dict[str, SE3]:
    """Return the poses of the bodies that are welded to the world, including the world itself."""
    fixed = np.flatnonzero(world.model.body_weldid == 0)
    return {name: world.pose(name) for name in (world.model.body(b).name for b in fixed)}


_SHAPES = {int(shape): name for name, shape in SHAPES.items()}
_SIZES = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "hull": 0}
