"""Random boards with blocks and no arms, for benchmarks and tests of perception."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3, SO3
from trocar.lab import SensorFlaws, load_station
from trocar.perception.image import Intrinsics
from trocar.sim.ray_camera import RayCamera
from trocar.sim.world import World
from trocar.tasks.peg_transfer.scene import PegScene
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from trocar.tasks.peg_transfer.world import PegWorld

CLEARANCE_M = 1.4e-3
"""Blocks stand off their peg by up to this in x and y, 2 mm in all: what the hole allows."""


def random_scene(rng: np.random.Generator, blocks: int = 6) -> tuple[PegScene, NDArray[np.intp]]:
    """Return a scene moved by a few mm and degrees, and the pegs (blocks,) that carry its blocks."""
    board, block = Pegboard(), Block()
    pegs = rng.permutation(len(board.pegs_m))[:blocks]
    tilt = np.radians([*rng.uniform(-1, 1, 2), rng.uniform(-4, 4)])
    T_world_board = SE3.from_parts(SO3.exp(tilt), rng.uniform(-3e-3, 3e-3, 3))
    turn = SO3.axis("z", rng.uniform(0, 2 * np.pi, blocks)) @ SO3(np.diag([1.0, -1.0, -1.0]))
    offset = np.column_stack([rng.uniform(-CLEARANCE_M, CLEARANCE_M, (blocks, 2)), np.full(blocks, block.height_m)])
    return PegScene(
        T_world_board, T_world_board @ SE3.from_parts(turn, board.pegs_m[pegs] + offset), board, block
    ), pegs


def world_of(scene: PegScene) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return model and state of a scene without arms, as it lies before physics moves it."""
    model = World({}, {}, PegWorld(scene)).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def overhead(model: mujoco.MjModel, binning: int = 1, flaws: SensorFlaws | None = None) -> RayCamera:
    """Return the camera over the board as its station has it; with fewer pixels if they are binned once more."""
    camera = load_station("peg-transfer").cameras["overhead"]
    assert isinstance(camera.model, Intrinsics)
    flaws = flaws or camera.flaws
    return RayCamera(model, camera.model.binned(binning), camera.T_world_camera, camera.lamp_m, flaws)
