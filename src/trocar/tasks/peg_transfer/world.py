"""Pegboard and blocks as bodies of the simulator, and the referee, which sees the truth and tells agents nothing."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco import mjtGeom
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.sim.record import CollidingPair, Record, Rows
from trocar.sim.spec import SOLID, UNSEEN_GROUP, digits, placed
from trocar.sim.world import TaskWorld, World
from trocar.tasks.peg_transfer.goals import Transfer
from trocar.tasks.peg_transfer.scene import PegScene
from trocar.tasks.peg_transfer.truth import PegTruth, pegs_under

FOOT_M = 0.05e-3
"""Gap between a block's prisms and the plate: a block stands on three feet, with three contacts and not thirty-six."""
ABS_RED = (0.83, 0.23, 0.07)
ABS_RED_BLOCK = (0.80, 0.20, 0.07)
BLACK_TABLE = (0.035, 0.035, 0.04)

STEEP = 0.7
"""A contact whose normal is closer to the vertical than 45 deg is on a peg's top, not at its side."""


class PegWorld(TaskWorld):
    """A pegboard with its blocks. An arm or a held block that touches the side of a peg counts as a collision."""

    sleeps = True

    def __init__(self, scene: PegScene):
        self._scene = scene
        self._held: dict[int, str] = {}
        self._errands: dict[Transfer, int] = {}

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add table, plates and pegs, and the blocks as free bodies."""
        _add_board(spec, self._scene)
        _add_blocks(spec, self._scene)

    def start(self, world: World) -> None:
        """Look up which block, peg or finger each geom belongs to."""
        self._world = world
        self._count = len(self._scene.T_world_blocks.matrix)
        self._held_at = {name: Rows(self._count, dtype=bool) for name in world.arms}
        self._T_board_blocks, self._pegs = Rows(self._count, 4, 4), Rows(self._count, dtype=int)
        self._block = _numbered(world, "block")
        self._peg = _numbered(world, "peg")
        self._finger = np.full(world.model.ngeom, -1, dtype=np.intp)
        for index in world.arms.values():
            self._finger[list(index.fingers)] = index.fingers

    def observe(self, time_s: float) -> None:
        """Record which blocks each arm holds: those that both of its fingers touch."""
        del time_s
        pairs = self._world.data.contact.geom[: self._world.data.ncon].T
        finger, block = np.maximum(*self._finger[pairs]), np.maximum(*self._block[pairs])
        there = (finger >= 0) & (block >= 0)
        touched: dict[int, set[int]] = {}
        for one, k in zip(finger[there].tolist(), block[there].tolist(), strict=True):
            touched.setdefault(one, set()).add(k)
        self._held = {}
        for name, index in self._world.arms.items():
            left, right = (touched.get(one, set()) for one in index.fingers)
            both = sorted(left & right)
            held = self._held_at[name].add()[0]
            held[:] = False
            held[both] = True
            self._held.update(dict.fromkeys(both, name))

    def collision(self, first: int, second: int) -> CollidingPair | None:
        """Return the colliding pair if an arm, or a block that it holds, touches a peg, else None."""
        for a, b in ((first, second), (second, first)):
            peg, arm, block = int(self._peg[b]), int(self._world.geom_arm[a]), int(self._block[a])
            if peg >= 0 and arm >= 0:
                return CollidingPair(self._world.arm_names[arm], "arm", f"peg {peg}")
            if peg >= 0 and block in self._held:
                return CollidingPair(self._held[block], "held block", f"peg {peg}")
        return None

    def counts(self, pair: CollidingPair, normal: NDArray[np.float64]) -> bool:
        """Return whether a contact is with another arm or with the side of a peg, not with a peg's top."""
        return not (pair.against.startswith("peg") and abs(normal[2]) > STEEP)

    def errand(self, goal: Transfer) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the centre (world, m) of a block's top face now, and once the block stands on the target.

        The block is the one that was nearest to the source at the first call for this transfer.
        """
        blocks = np.stack([self._world.free_pose(f"block{k}").translation_m for k in range(self._count)])
        scene, lies = self._scene, [0.0, 0.0, self._scene.block.height_m]
        source, target = scene.T_world_board.apply(scene.board.pegs_m[list(goal)] + lies)
        block = self._errands.setdefault(goal, int(np.linalg.norm(blocks - source, axis=1).argmin()))
        return blocks[block], target

    def truth(self, record: Record) -> PegTruth:
        """Return where blocks and tips were in the board's frame, and when blocks were held.

        Only the rows that are new since the last call are computed: a learner's referee looks once a second.
        """
        scene, T_board_world = self._scene, self._scene.T_world_board.inverse()
        new = [record.T_world_body[f"block{k}"].matrix[len(self._pegs) :] for k in range(self._count)]
        T_board_blocks = T_board_world @ SE3.unchecked(np.stack(new, axis=1))
        self._T_board_blocks.add(len(new[0]))[:] = T_board_blocks.matrix
        self._pegs.add(len(new[0]))[:] = pegs_under(T_board_blocks, scene.board, scene.block)
        return PegTruth(
            times_s=record.times_s,
            T_board_blocks=SE3.unchecked(self._T_board_blocks.read()),
            pegs=self._pegs.read(),
            held_by={name: rows.read() for name, rows in self._held_at.items()},
            p_board_tips={name: T_board_world.apply(T.translation_m) for name, T in record.T_world_tip.items()},
            board=scene.board,
            block=scene.block,
        )

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return the board's true pose."""
        del record
        return {"T_world_board": self._scene.T_world_board.matrix}


def _numbered(world: World, prefix: str) -> NDArray[np.intp]:
    """Return the number after this prefix in the name of each geom; -1 for other names."""
    numbers = np.full(world.model.ngeom, -1, dtype=np.intp)
    for g in world.geoms(prefix):
        numbers[g] = int(world.model.geom(int(g)).name.removeprefix(prefix).split("_")[0])
    return numbers


def _add_board(spec: mujoco.MjSpec, scene: PegScene) -> None:
    board = spec.worldbody.add_body(name="board", **placed(scene.T_world_board))
    below = min(height for *_, height in scene.board.plates_m) - 0.005
    red = {"rgba": (*ABS_RED, 1), **SOLID}
    for index, (width, depth, height) in enumerate(scene.board.plates_m):
        half = 0.5 * (height - below)
        size, place = digits((width / 2, depth / 2, half)), digits((0, 0, height - half))
        board.add_geom(name=f"plate{index}", type=mjtGeom.mjGEOM_BOX, size=size, pos=place, **red)
    radius, height = scene.board.peg_radius_m, scene.board.peg_height_m
    for index, (x, y, z) in enumerate(scene.board.pegs_m):
        axis = digits((x, y, z, x, y, z + height - radius))
        size = digits((radius, 0, 0))
        board.add_geom(name=f"peg{index}", type=mjtGeom.mjGEOM_CAPSULE, size=size, fromto=axis, **red)
    plane = {"type": mjtGeom.mjGEOM_PLANE, "size": (0.5, 0.5, 0.01), "rgba": (*BLACK_TABLE, 1)}
    spec.worldbody.add_geom(name="table", pos=digits((0, 0, below)), **plane, **SOLID)


def _add_blocks(spec: mujoco.MjSpec, scene: PegScene) -> None:
    pieces = [piece - [0, 0, FOOT_M] * (piece[:, 2:] > 0) for piece in scene.block.convex_pieces()]
    for index, piece in enumerate(pieces):
        spec.add_mesh(name=f"block_piece{index}", uservert=digits(piece).ravel())
    red, radius = {"rgba": (*ABS_RED_BLOCK, 1), **SOLID}, FOOT_M * 10
    for number, pose in enumerate(scene.T_world_blocks.matrix):
        body = spec.worldbody.add_body(name=f"block{number}", **placed(SE3.unchecked(pose)))
        body.add_freejoint(name=f"block{number}")
        for index, corner in enumerate(scene.block.corners_m()):
            body.add_geom(
                name=f"block{number}_foot{index}",
                type=mjtGeom.mjGEOM_SPHERE,
                size=digits((radius, 0, 0)),
                pos=digits(corner + [0, 0, scene.block.height_m - radius]),
                group=UNSEEN_GROUP,
                **red,
            )
        for index in range(len(pieces)):
            body.add_geom(
                name=f"block{number}_{index}",
                type=mjtGeom.mjGEOM_MESH,
                meshname=f"block_piece{index}",
                density=digits(scene.block.density_kg_m3),
                **red,
            )
