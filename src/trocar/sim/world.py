"""The physics of one cell: MuJoCo's model and state behind names of ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.scene import Scene
from trocar.sim.mjcf import TIMESTEP_S, CellModel, build_mjcf


@dataclass(frozen=True, eq=False)
class ArmIndex:
    """Where one arm's numbers stand in MuJoCo's arrays."""

    qpos: NDArray[np.intp]
    dof: NDArray[np.intp]
    drive: NDArray[np.intp]
    feed: NDArray[np.intp]
    damping: NDArray[np.float64]
    jaw_qpos: int
    jaw_drive: int
    geoms: NDArray[np.intp]
    fingers: tuple[int, int]


class World:
    """Bodies, contacts and drives of the simulated cell. Only the simulator and the referee may look inside.

    Attributes:
        effects: called before the physics advances: what MuJoCo does not know of.
    """

    def __init__(self, cell: CellModel):
        self.cell = cell
        self.model = mujoco.MjModel.from_xml_string(build_mjcf(cell))
        self.data = mujoco.MjData(self.model)
        self.arms = {name: self._index(name, arm) for name, arm in cell.arms.items()}
        self.effects: list[Callable[[], None]] = []
        self.block_count = len(cell.scene.T_world_blocks.matrix) if isinstance(cell.scene, Scene) else 0
        self._block_qpos = np.array(
            [self.model.joint(f"block{k}").qposadr[0] for k in range(self.block_count)], dtype=np.intp
        )
        self.geom_block = self._geoms_by_prefix("block")
        self.geom_peg = self._geoms_by_prefix("peg")

    def _index(self, name: str, arm: ArmModel) -> ArmIndex:
        m = self.model
        joints = [m.joint(f"{name}_{joint.name}") for joint in arm.joints]
        fingers = (m.geom(f"{name}_finger_left").id, m.geom(f"{name}_finger_right").id)
        geoms = [g for g in range(m.ngeom) if m.geom(g).name.startswith(f"{name}_")]
        return ArmIndex(
            qpos=np.array([j.qposadr[0] for j in joints]),
            dof=np.array([j.dofadr[0] for j in joints]),
            drive=np.array([m.actuator(f"{name}_{j.name}").id for j in arm.joints]),
            feed=np.array([m.actuator(f"{name}_{j.name}_feed").id for j in arm.joints]),
            damping=np.array(self.cell.servo.damping),
            jaw_qpos=int(m.joint(f"{name}_jaw_left").qposadr[0]),
            jaw_drive=m.actuator(f"{name}_jaw").id,
            geoms=np.array(geoms),
            fingers=fingers,
        )

    def _geoms_by_prefix(self, prefix: str) -> NDArray[np.intp]:
        """Return for each geom the number behind this prefix in its name, or -1."""
        numbers = np.full(self.model.ngeom, -1, dtype=np.intp)
        for g in range(self.model.ngeom):
            name = self.model.geom(g).name
            if name.startswith(prefix):
                numbers[g] = int(name.removeprefix(prefix).split("_")[0])
        return numbers

    def place_arm(self, name: str, q_joint: NDArray[np.float64], jaw_rad: float) -> None:
        """Put an arm at rest at these joints (6,), its drives holding it there."""
        index = self.arms[name]
        self.data.qpos[index.qpos] = q_joint
        self.data.qpos[index.jaw_qpos] = jaw_rad / 2
        self.data.qpos[self.model.joint(f"{name}_jaw_right").qposadr[0]] = -jaw_rad / 2
        self.data.qvel[index.dof] = 0.0
        self.drive_arm(name, q_joint, np.zeros(6), jaw_rad)
        mujoco.mj_forward(self.model, self.data)

    def drive_arm(self, name: str, q_joint: NDArray[np.float64], v_joint: NDArray[np.float64], jaw_rad: float) -> None:
        """Set what the drives of an arm pull to: joints (6,), their velocities, the jaws' opening."""
        index = self.arms[name]
        self.data.ctrl[index.drive] = q_joint
        self.data.ctrl[index.feed] = index.damping * v_joint
        self.data.ctrl[index.jaw_drive] = jaw_rad / 2

    def step(self, count: int) -> None:
        """Advance the physics by ``count`` steps."""
        for effect in self.effects:
            effect()
        mujoco.mj_step(self.model, self.data, count)
        if self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise TrocarError(
                f"the physics became unstable at {self.data.time:.3f} s; the trial is void: report its seed"
            )

    @property
    def time_s(self) -> float:
        """Return the clock of the physics."""
        return float(self.data.time)

    def joints(self, name: str) -> NDArray[np.float64]:
        """Return the true joints (6,)."""
        return self.data.qpos[self.arms[name].qpos].copy()

    def jaw_rad(self, name: str) -> float:
        """Return the true opening of the jaws."""
        return 2.0 * float(self.data.qpos[self.arms[name].jaw_qpos])

    def blocks(self) -> SE3:
        """Return the true poses of the blocks in the world."""
        qpos = self.data.qpos[self._block_qpos[:, None] + np.arange(7)]
        return SE3.from_parts(SO3.from_quaternion(qpos[:, 3:]), qpos[:, :3])

    def settle(self, seconds: float) -> None:
        """Let the blocks come to rest, then start the clock at zero."""
        self.step(round(seconds / TIMESTEP_S))
        self.data.time = 0.0
