"""The physics of one cell, and a task's part of it: bodies, forces on them, and the task's referee."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import TrocarError, UnknownName
from trocar.geometry import SE3, SO3
from trocar.geometry.arrays import Array
from trocar.perception.fiducials import Fixture
from trocar.sim.record import CollidingPair, Record
from trocar.sim.spec import SERVO, TIMESTEP_S, CellArms, Surface, cell_spec

_WARNINGS = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
UNSTABLE = tuple(int(warning) for warning in _WARNINGS)
"""Warnings after which MuJoCo has silently reset its state."""


class PhysicsError(TrocarError):
    """The simulation became unstable; the trial is void.

    Attributes:
        time_s: time on the physics' clock.
    """

    def __init__(self, time_s: float):
        self.time_s = time_s
        super().__init__(f"the physics became unstable at {time_s:.3f} s; the trial is void: report its seed")


class TaskWorld:
    """A task's side of the simulator. The base class is an empty world; a task overrides what it needs.

    Attributes:
        sleeps: whether bodies at rest may be left out of the physics until something touches them.
    """

    sleeps = False

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add bodies to MuJoCo's model specification, usually to ``spec.worldbody``.

        ``trocar.sim.spec`` has attributes for poses and collisions. A body with a free joint is recorded and replayed
        by its name.
        """

    def start(self, world: World) -> None:
        """Look up ids in the finished world; called once, when the arms are parked."""

    def act(self) -> None:
        """Apply effects that MuJoCo does not model; called each time before the physics advances by a few steps."""

    def collision(self, first: int, second: int) -> CollidingPair | None:
        """Return the colliding pair if a contact between these two geoms counts as a collision, else None.

        It is not called for contacts between two arms, whose pair is known.
        """
        del first, second
        return None

    def counts(self, pair: CollidingPair, normal: Array) -> bool:
        """Return whether a pair's contact with this normal (3,) counts; called for forces above ``COLLISION_N``."""
        del pair, normal
        return True

    def observe(self, time_s: float) -> None:
        """Observe the world; called after each tick of the controller, before :meth:`collision` for its contacts."""

    def errand(self, goal: Any) -> tuple[Array, Array] | None:
        """Return present and wanted position (3,), in the world, of a goal's object; None if unknown.

        Only dense rewards use it (``trocar.learn``). It is called for the goals in order, for each while it is the next
        one to be reached.
        """
        del goal
        return None

    def truth(self, record: Record) -> Any:
        """Return the task's truth, only for the task's score."""
        return record

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return arrays to save for the task's own pictures, in addition to joints and poses."""
        del record
        return {}

    def assistants(self) -> Mapping[str, Any]:
        """Return the people beside the robot, by what they do."""
        return {}


@dataclass(frozen=True, eq=False)
class ArmIndex:
    """Indices of one arm in MuJoCo's arrays."""

    qpos: NDArray[np.intp]
    dof: NDArray[np.intp]
    drive: NDArray[np.intp]
    feed: NDArray[np.intp]
    damping: Array
    jaw_qpos: int
    jaw_drive: int
    fingers: tuple[int, int]


class World:
    """Bodies, contacts and drives of the simulated cell. Only the simulator and the referee may look inside.

    Args:
        models: the arms' models by name.
        T_world_base: true pose of each arm's base.
        task: the task's side of the world; None: nothing.
        surface: contact parameters.
        fixtures: spheres for calibration, by the arm whose instrument carries them.

    Attributes:
        models: as given; so are ``T_world_base`` and ``task``.
        model: MuJoCo's model.
        data: MuJoCo's data.
        arms: indices of each arm in MuJoCo's arrays, by name.
        arm_names: names of the arms, in order.
        geom_arm: number of each geom's arm, or -1.
        free_bodies: names of the bodies with a free joint.
    """

    def __init__(
        self,
        models: Mapping[str, ArmModel],
        T_world_base: Mapping[str, SE3],
        task: TaskWorld | None = None,
        *,
        surface: Surface | None = None,
        fixtures: Mapping[str, Fixture] | None = None,
    ):
        self.models, self.T_world_base, self.task = models, T_world_base, task or TaskWorld()
        arms = CellArms(models, T_world_base, surface or Surface(), fixtures or {})
        self.model = cell_spec(arms, self.task.add, sleeps=self.task.sleeps).compile()
        self.data = mujoco.MjData(self.model)
        self._warnings = self.data.warning.number  # counts of each kind, a view that MuJoCo updates
        self.arms = {name: self._index(name, arm) for name, arm in models.items()}
        self.arm_names = tuple(models)
        self.geom_arm = np.full(self.model.ngeom, -1)
        for number, name in enumerate(self.arm_names):
            self.geom_arm[self.geoms(f"{name}_")] = number
        joints = [self.model.joint(j) for j in range(self.model.njnt)]
        free = [joint for joint in joints if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE]
        self.free_bodies = tuple(self.model.body(joint.bodyid[0]).name for joint in free)
        self._free_qpos = np.array([joint.qposadr[0] for joint in free], dtype=np.intp)[:, None] + np.arange(7)

    def _index(self, name: str, arm: ArmModel) -> ArmIndex:
        m, labels = self.model, [f"{name}_{joint.name}" for joint in arm.joints]
        return ArmIndex(
            qpos=np.array([m.joint(label).qposadr[0] for label in labels]),
            dof=np.array([m.joint(label).dofadr[0] for label in labels]),
            drive=np.array([m.actuator(label).id for label in labels]),
            feed=np.array([m.actuator(f"{label}_feed").id for label in labels]),
            damping=np.array(SERVO.damping),
            jaw_qpos=int(m.joint(f"{name}_jaw_left").qposadr[0]),
            jaw_drive=m.actuator(f"{name}_jaw").id,
            fingers=(m.geom(f"{name}_finger_left").id, m.geom(f"{name}_finger_right").id),
        )

    def geoms(self, prefix: str) -> NDArray[np.intp]:
        """Return the ids of the geoms whose names begin with this."""
        names = [self.model.geom(g).name for g in range(self.model.ngeom)]
        return np.array([g for g, name in enumerate(names) if name.startswith(prefix)], dtype=np.intp)

    def place_arm(self, name: str, q_joint: Array, jaw_rad: float) -> None:
        """Put an arm at rest at these joints (6,), where its drives hold it."""
        index = self.arms[name]
        self.data.qpos[index.qpos] = q_joint
        self.data.qpos[index.jaw_qpos] = jaw_rad / 2
        self.data.qpos[self.model.joint(f"{name}_jaw_right").qposadr[0]] = -jaw_rad / 2
        self.data.qvel[index.dof] = 0.0
        self.drive_arm(name, q_joint, np.zeros(6), jaw_rad)
        mujoco.mj_forward(self.model, self.data)

    def drive_arm(self, name: str, q_joint: Array, v_joint: Array, jaw_rad: float) -> None:
        """Set the targets of an arm's drives: joints (6,), their velocities, the jaws' opening."""
        index = self.arms[name]
        self.data.ctrl[index.drive] = q_joint
        self.data.ctrl[index.feed] = index.damping * v_joint
        self.data.ctrl[index.jaw_drive] = jaw_rad / 2

    def step(self, count: int) -> None:
        """Advance the physics by ``count`` steps (PhysicsError: it became unstable)."""
        self.task.act()
        mujoco.mj_step(self.model, self.data, count)
        if any(self._warnings[kind] for kind in UNSTABLE):
            raise PhysicsError(self.data.time)

    @property
    def time_s(self) -> float:
        """Return the time of the physics' clock."""
        return float(self.data.time)

    def joints(self, name: str) -> Array:
        """Return the true joints (6,)."""
        return self.data.qpos[self.arms[name].qpos]

    def jaw_rad(self, name: str) -> float:
        """Return the true opening of the jaws."""
        return 2.0 * float(self.data.qpos[self.arms[name].jaw_qpos])

    def free_poses(self) -> Array:
        """Return positions and quaternions wxyz (k, 7) of the free bodies, in the order of ``free_bodies``."""
        return self.data.qpos[self._free_qpos]

    def pose(self, body: str) -> SE3:
        """Return the true pose of a body in the world, as of the last step (UnknownName: there is none)."""
        index = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, body)
        if index < 0:
            raise UnknownName("body", body, [self.model.body(b).name for b in range(1, self.model.nbody)])
        return SE3.from_parts(SO3.unchecked(self.data.xmat[index].reshape(3, 3)), self.data.xpos[index])

    def free_pose(self, body: str) -> SE3:
        """Return the true pose of a free body in the world, now (UnknownName: there is none)."""
        if body not in self.free_bodies:
            raise UnknownName("free body", body, self.free_bodies)
        row = self.free_poses()[self.free_bodies.index(body)]
        return SE3.from_parts(SO3.from_quaternion(row[3:]), row[:3])

    def settle(self, seconds: float) -> None:
        """Let the bodies come to rest, then start the clock at zero."""
        self.step(round(seconds / TIMESTEP_S))
        self.data.time = 0.0


STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def state_of(world: World) -> bytes:
    """Return the state that determines the physics from here on, a few kilobytes, to show it in another process."""
    state = np.empty(mujoco.mj_stateSize(world.model, STATE))
    mujoco.mj_getState(world.model, world.data, state, STATE)
    return state.tobytes()


class WorldCopy:
    """A copy of a world's bodies in another process.

    Attributes:
        data: MuJoCo's data, with the bodies at their poses.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model, self.data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)

    def put(self, state: bytes) -> None:
        """Move the bodies into a state that :func:`state_of` returned."""
        mujoco.mj_setState(self._model, self.data, np.frombuffer(state), STATE)
        mujoco.mj_kinematics(self._model, self.data)
