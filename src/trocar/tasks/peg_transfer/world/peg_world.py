"""The pegboard in the simulator, and its referee, who sees everything and tells no agent."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.geometry import SE3
from trocar.sim.record import CollidingPair, Record
from trocar.sim.world import TaskWorld, World
from trocar.tasks.peg_transfer.scene import PegScene
from trocar.tasks.peg_transfer.truth import PegTruth
from trocar.tasks.peg_transfer.world.bodies import add_pegboard

STEEP = 0.7
"""A contact whose normal is closer to the vertical than 45 deg is on a peg's top, not at its side."""


class PegWorld(TaskWorld):
    """A pegboard with its blocks. Collisions are arms and held blocks against the sides of pegs."""

    sleeps = True

    def __init__(self, scene: PegScene):
        self._scene = scene
        self._held_at: dict[str, list[NDArray[np.bool_]]] = {}
        self._held: dict[int, str] = {}

    def add(self, spec: mujoco.MjSpec) -> None:
        """Add table, board and blocks."""
        add_pegboard(spec, self._scene)

    def start(self, world: World) -> None:
        """Number the geoms of blocks and pegs."""
        self._world = world
        self._count = len(self._scene.T_world_blocks.matrix)
        self._block = _numbered(world, "block")
        self._peg = _numbered(world, "peg")
        self._finger = np.full(world.model.ngeom, -1, dtype=np.intp)
        for index in world.arms.values():
            self._finger[list(index.fingers)] = index.fingers

    def observe(self, time_s: float) -> None:
        """Note which blocks each arm holds: those that both its fingers touch."""
        del time_s
        pairs = self._world.data.contact.geom[: self._world.data.ncon]
        held_by = self._held_blocks(pairs)
        self._held = {block: name for name, blocks in held_by.items() for block in blocks}
        for name, blocks in held_by.items():
            self._held_at.setdefault(name, []).append(np.array([k in blocks for k in range(self._count)]))

    def _held_blocks(self, pairs: NDArray[np.int32]) -> dict[str, set[int]]:
        """Return the blocks that each arm holds."""
        finger, block = np.maximum(*self._finger[pairs.T]), np.maximum(*self._block[pairs.T])
        there = (finger >= 0) & (block >= 0)
        touched = set(zip(finger[there].tolist(), block[there].tolist(), strict=True))
        return {
            name: {k for k in range(self._count) if all((one, k) in touched for one in index.fingers)}
            for name, index in self._world.arms.items()
        }

    def collision(self, first: int, second: int) -> CollidingPair | None:
        """Return who collides if an arm, or a block that it holds, touches a peg."""
        for a, b in ((first, second), (second, first)):
            peg, arm, block = int(self._peg[b]), int(self._world.geom_arm[a]), int(self._block[a])
            if peg >= 0 and arm >= 0:
                return CollidingPair(self._world.arm_names[arm], "arm", f"peg {peg}")
            if peg >= 0 and block in self._held:
                return CollidingPair(self._held[block], "held block", f"peg {peg}")
        return None

    def counts(self, pair: CollidingPair, normal: NDArray[np.float64]) -> bool:
        """Return whether it is a peg's side that is touched, or an arm."""
        return not (pair.against.startswith("peg") and abs(normal[2]) > STEEP)

    def truth(self, record: Record) -> PegTruth:
        """Return where blocks and tips were in the board's frame, and when blocks were held."""
        T_board_world = self._scene.T_world_board.inverse()
        held_by = {name: np.array(rows) for name, rows in self._held_at.items()}
        poses = [record.T_world_body[f"block{k}"].matrix for k in range(self._count)]
        return PegTruth(
            times_s=record.times_s,
            T_board_blocks=T_board_world @ SE3.unchecked(np.stack(poses, axis=1)),
            held=np.any(list(held_by.values()), axis=0),
            p_board_tips={name: T_board_world.apply(T.translation_m) for name, T in record.T_world_tip.items()},
            board=self._scene.board,
            block=self._scene.block,
            held_by=held_by,
        )

    def arrays(self, record: Record) -> Mapping[str, NDArray]:
        """Return the board's true pose."""
        del record
        return {"T_world_board": self._scene.T_world_board.matrix}


def _numbered(world: World, prefix: str) -> NDArray[np.intp]:
    """Return for each geom the number behind this prefix in its name, or -1."""
    numbers = np.full(world.model.ngeom, -1, dtype=np.intp)
    for g in world.geoms(prefix):
        numbers[g] = int(world.model.geom(int(g)).name.removeprefix(prefix).split("_")[0])
    return numbers
