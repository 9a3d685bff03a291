"""A pegboard and its blocks as bodies of the simulator."""

from __future__ import annotations

import mujoco
from mujoco import mjtGeom

from trocar.geometry import SE3
from trocar.sim.spec import SOLID, UNSEEN_GROUP, digits, placed
from trocar.tasks.peg_transfer.scene import PegScene

FOOT_M = 0.05e-3
"""Height of the prisms of a block above its three feet, so that it has three contacts with the plate, not
thirty-six."""

ABS_RED = (0.83, 0.23, 0.07)
ABS_RED_BLOCK = (0.80, 0.20, 0.07)
BLACK_TABLE = (0.035, 0.035, 0.04)


def add_pegboard(spec: mujoco.MjSpec, scene: PegScene) -> None:
    """Add table, plates and pegs, and the blocks as free bodies."""
    _add_board(spec, scene)
    _add_blocks(spec, scene)


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
