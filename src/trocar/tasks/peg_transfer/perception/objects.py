"""A policy's observation of a peg transfer: numbers from images that are taken while the arms work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.eval.objects import WatchedObjects
from trocar.geometry import SE3
from trocar.perception.image import Image
from trocar.tasks.peg_transfer.goals import PegSet, Transfer
from trocar.tasks.peg_transfer.grasps import Grasp, plan_grasp, yaw_of
from trocar.tasks.peg_transfer.perception import depth_camera

MOVED_M = 1e-3
"""A block that is seen this far from its last place has moved, and its grasp is planned again."""
_XYZ = tuple(f"position.{axis}" for axis in "xyz")
_OF_GOAL = (*(f"block.{name}" for name in (*_XYZ, "cos_3yaw", "sin_3yaw")),)
_OF_GOAL += (*(f"grasp.{name}" for name in (*_XYZ, "cos_yaw", "sin_yaw", "jaw")),)
_OF_GOAL += (*(f"target.{name}" for name in _XYZ), "done")


@dataclass(frozen=True, eq=False)
class Seen:
    """What one image shows.

    Attributes:
        T_world_board: pose of the board, from the first image that shows it.
        blocks: poses of the blocks in the board's frame, by peg.
        grasps: for each block that has moved, by peg: its pose, and the grasp that was planned for it.
    """

    T_world_board: SE3
    blocks: Mapping[int, SE3]
    grasps: Mapping[int, tuple[SE3, Grasp]]


class PegObjects(WatchedObjects):
    """Each transfer's block, its grasp and its target in the world, as last seen.

    The numbers of a transfer are, for the block on its source peg: the middle (m) of the top face, and cosine and sine
    of three times the yaw, since the three walls are alike; for the grasp that ``plan_grasp`` plans for the nearest
    arm: position (m) of the tip, cosine and sine of the yaw of its x axis, and opening of the jaws (rad); the foot (m)
    of the target peg; and 1 once images showed that the transfer was done, else 0.

    Before a block has been seen, block and grasp are at the source peg, and their other numbers are 0. The numbers of
    a hidden block stay as they were.

    Attributes:
        names: names of the numbers.
        values: the numbers, each from -1 to 1.
    """

    budget_s = 0.25  # the board, and then up to twelve blocks

    def __init__(self, cell: Cell, goals: Sequence[Transfer], nominal: PegSet, perception: Any):
        super().__init__(cell, depth_camera(cell))
        self._goals, self._board, self._block = goals, nominal.board, nominal.block
        self._see, self._T_world_board, self._found = perception, cell.T_world_fixture["board"], False
        self._arms = list(cell.arms)[: 1 if nominal.variant == "unilateral" else 2]
        self.names = [f"transfer{number}.{name}" for number in range(1, len(goals) + 1) for name in _OF_GOAL]
        self._blocks: dict[int, SE3] = {}
        self._grasps: dict[int, tuple[SE3, Grasp]] = {}  # with the pose of the block for which each was planned
        self._done: set[int] = set()

    @property
    def values(self) -> NDArray[np.float64]:
        """Return the numbers as they are now known."""
        rows = []
        for number, goal in enumerate(self._goals):
            source, target = self._T_world_board.apply(self._board.pegs_m[list(goal)])
            top = source + [0, 0, self._block.height_m]
            block, grasp = np.hstack([top, 0, 0]), np.hstack([top, 0, 0, 0])
            if goal.source in self._blocks:
                pose = self._T_world_board @ self._blocks[goal.source]
                yaw = 3 * yaw_of(pose)
                block = np.hstack([pose.translation_m, np.cos(yaw), np.sin(yaw)])
            if goal.source in self._grasps:
                planned = self._grasps[goal.source][1]
                pose = self._T_world_board @ planned.T_board_tip
                yaw = yaw_of(pose)
                grasp = np.hstack([pose.translation_m, np.cos(yaw), np.sin(yaw), planned.jaw_rad])
            rows.append(np.hstack([block, grasp, target, float(number in self._done)]))
        return np.clip(np.hstack(rows), -1.0, 1.0)

    def find(self, image: Image) -> Seen | None:
        """Return the board, the visible blocks, and grasps of those that moved; None if no board has been seen."""
        board = self._T_world_board
        if not self._found:
            found = self._see.find_board(image, self.T_world_camera, self._board, board)
            if isinstance(found, str):
                return None
            board = found
        T_camera_board = self.T_world_camera.inverse() @ board
        pegs = sorted({peg for goal in self._goals for peg in goal})
        seen = {peg: self._see.find_block(image, T_camera_board, self._board, self._block, peg) for peg in pegs}
        blocks = {peg: pose for peg, pose in seen.items() if not isinstance(pose, str)}
        grasps = {}
        for peg in {goal.source for goal in self._goals} & blocks.keys():
            before = self._grasps.get(peg)
            off = np.inf if before is None else np.linalg.norm(blocks[peg].translation_m - before[0].translation_m)
            grasp = self._planned(board, blocks[peg]) if off > MOVED_M else None
            if isinstance(grasp, Grasp):
                grasps[peg] = blocks[peg], grasp
        return Seen(board, blocks, grasps)

    def _planned(self, T_world_board: SE3, T_board_block: SE3) -> Grasp | str:
        bases = [self.cell.T_world_base_registered[arm] for arm in self._arms]
        at = (T_world_board @ T_board_block).translation_m
        nearest = int(np.argmin([np.linalg.norm(base.translation_m - at) for base in bases]))
        T_base_board = bases[nearest].inverse() @ T_world_board
        return plan_grasp(self.cell.arms[self._arms[nearest]], T_base_board, T_board_block, self._board, self._block)

    def take(self, found: Seen | None) -> None:
        """Store what was found, and update which transfers are done.

        A transfer is done once a block has been on its source and is not there now, and a block is on its target. The
        target alone does not tell: on the way back, blocks lie on the targets from the start.
        """
        if found is None:
            return
        self._T_world_board, self._found = found.T_world_board, True
        self._blocks |= found.blocks
        self._grasps |= found.grasps
        for number, goal in enumerate(self._goals):
            if goal.source in self._blocks and goal.source not in found.blocks and goal.target in found.blocks:
                self._done.add(number)
