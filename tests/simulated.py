"""Simulated cells for tests: cables without errors, and an arm that works by true poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.agents import Settings
from trocar.arms import ARMS, MOTION_LIMITS, MotionLimits, fk, ik
from trocar.calibration.plant import CablePlant
from trocar.geometry import SE3, SO3
from trocar.motion import rest_to_rest, straight
from trocar.scene import Block, Pegboard, Scene
from trocar.scene.grasps import Grasp, choose_grasp
from trocar.sim.cell import SimulatedCell
from trocar.sim.mjcf import CellModel, Surface
from trocar.sim.session import ARM_NAMES, T_WORLD_BASE, Session
from trocar.sim.world import World

PAPER = MOTION_LIMITS["paper"]
TWICE = MotionLimits(2 * PAPER.velocity, 2 * PAPER.acceleration)
JAW_CLOSED = Settings().jaw_closed

STIFF_CABLES = CablePlant(
    radii=np.zeros(3),
    a=0.0,
    b=0.0,
    offset=np.zeros(3),
    K=np.zeros((3, 3)),
    C=np.zeros((3, 3)),
    noise_sd=np.zeros(6),
    source="cables without errors",
)
ARM_MODELS = {name: ARMS["psm-classic"] for name in ARM_NAMES}


def ideal_session(T_world_base: Mapping[str, SE3] | None = None) -> Session:
    """Return a cell whose joints follow their encoders and whose registration is exact."""
    bases = T_world_base or T_WORLD_BASE
    arms = {name: ARM_MODELS[name] for name in bases}
    return Session(arms, dict.fromkeys(arms, STIFF_CABLES), bases, bases)


def standing(peg: int, offset_m=(0.0, 0.0), yaw_rad: float = 0.0, height_m: float = 0.0) -> SE3:
    """Return ``T_board_block`` of a block upright round a peg, its lower face at this height."""
    place = Pegboard().pegs_m[peg] + [*offset_m, Block().height_m + height_m]
    return SE3.from_parts(SO3.axis("x", np.pi) @ SO3.axis("z", yaw_rad), place)


def scene_of(*T_board_blocks: SE3) -> Scene:
    """Return a scene with the board at the world's origin and these blocks."""
    return Scene(Pegboard(), Block(), SE3.identity(), SE3(np.stack([T.matrix for T in T_board_blocks])))


def world_with_arms(*T_board_blocks: SE3, surface: Surface | None = None) -> World:
    """Return a world with both arms at zero and these blocks."""
    return World(CellModel(scene_of(*T_board_blocks), ARM_MODELS, T_WORLD_BASE, surface=surface or Surface()))


def joints_at(arm: str, p_world_tip_m, yaw_rad: float = 0.0) -> NDArray[np.float64]:
    """Return the joints (6,) that hold this arm's tip there, the tool vertical."""
    T_world_tip = SE3.from_parts(SO3.axis("z", yaw_rad), p_world_tip_m)
    return ik(ARM_MODELS[arm], T_WORLD_BASE[arm].inverse() @ T_world_tip)


class Hand:
    """One arm of an ideal cell that grasps by true poses; its methods are scripts for ``SimulatedCell.run``."""

    def __init__(self, cell: SimulatedCell, arm: str = "psm1"):
        self.cell, self.arm, self.robot = cell, arm, cell.robot
        self.model = cell.session.arms[arm]
        self.T_base_world = cell.session.T_world_base[arm].inverse()

    @property
    def q(self) -> NDArray[np.float64]:
        """Return the commanded joints."""
        return self.robot.read(self.arm).q

    def T_tip_block(self, block: int) -> SE3:
        """Return the true pose of a block in the true tip."""
        T_world_tip = self.T_base_world.inverse() @ fk(self.model, self.cell.world.joints(self.arm))
        return T_world_tip.inverse() @ self.cell.world.blocks()[block]

    async def go(self, q: NDArray[np.float64], limits: MotionLimits = PAPER) -> None:
        """Move straight in joint space."""
        await self.robot.move(self.arm, rest_to_rest(self.q, q, limits))

    async def shift(self, displacement_m, limits: MotionLimits = PAPER) -> None:
        """Move the tip straight, in the world's axes."""
        line = self.T_base_world.rotation.apply(np.array(displacement_m))
        await self.robot.move(self.arm, straight(self.model, self.q, line, limits))

    async def grasp(self, block: int) -> Grasp:
        """Close the jaws round a wall of this block where it stands on its peg."""
        T_world_board = self.cell.world.cell.scene.T_world_board
        blocks = T_world_board.inverse() @ self.cell.world.blocks()
        T_base_board = self.T_base_world @ T_world_board
        grasp = choose_grasp(self.model, T_base_board, blocks[block], Pegboard(), Block(), blocks)
        assert isinstance(grasp, Grasp), grasp
        above = SE3.from_parts(translation_m=[0.0, 0.0, 0.03]) @ grasp.T_board_tip
        await self.robot.jaw(self.arm, grasp.jaw_rad)
        await self.go(ik(self.model, T_base_board @ above))
        await self.shift([0.0, 0.0, -0.03])
        await self.robot.jaw(self.arm, JAW_CLOSED)
        return grasp
