"""A pegboard and its blocks in MJCF."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from trocar.geometry import SE3
from trocar.sim.elements import UNSEEN_GROUP, add, placed, scene_bits, text
from trocar.tasks.peg_transfer.truth import PegScene

FOOT_M = 0.05e-3
"""Height of the prisms of a block above its three feet, so that it has three contacts with the plate, not
thirty-six."""

ABS_RED = (0.83, 0.23, 0.07)
ABS_RED_BLOCK = (0.80, 0.20, 0.07)
BLACK_TABLE = (0.035, 0.035, 0.04)


def add_pegboard(world: Element, assets: Element, scene: PegScene) -> None:
    """Add table, plates and pegs, and the blocks as free bodies."""
    _add_board(world, scene)
    _add_blocks(world, assets, scene)


def _add_board(world: Element, scene: PegScene) -> None:
    board = add(world, "body", name="board", **placed(scene.T_world_board))
    below = min(height for *_, height in scene.board.plates_m) - 0.005
    for index, (width, depth, height) in enumerate(scene.board.plates_m):
        half = 0.5 * (height - below)
        add(
            board,
            "geom",
            name=f"plate{index}",
            type="box",
            size=text((width / 2, depth / 2, half)),
            pos=text((0, 0, height - half)),
            rgba=text((*ABS_RED, 1)),
            **scene_bits(),
        )
    radius, height = scene.board.peg_radius_m, scene.board.peg_height_m
    for index, (x, y, z) in enumerate(scene.board.pegs_m):
        add(
            board,
            "geom",
            name=f"peg{index}",
            type="capsule",
            size=text(radius),
            fromto=text((x, y, z, x, y, z + height - radius)),
            rgba=text((*ABS_RED, 1)),
            **scene_bits(),
        )
    add(
        world,
        "geom",
        name="table",
        type="plane",
        size="0.5 0.5 0.01",
        pos=text((0, 0, below)),
        rgba=text((*BLACK_TABLE, 1)),
        **scene_bits(),
    )


def _add_blocks(world: Element, assets: Element, scene: PegScene) -> None:
    pieces = [piece - [0, 0, FOOT_M] * (piece[:, 2:] > 0) for piece in scene.block.convex_pieces()]
    for index, piece in enumerate(pieces):
        add(assets, "mesh", name=f"block_piece{index}", vertex=text(piece))
    for number, pose in enumerate(scene.T_world_blocks.matrix):
        body = add(world, "body", name=f"block{number}", **placed(SE3.unchecked(pose)))
        add(body, "freejoint", name=f"block{number}")
        for index, corner in enumerate(scene.block.corners_m()):
            add(
                body,
                "geom",
                name=f"block{number}_foot{index}",
                type="sphere",
                size=text(FOOT_M * 10),
                pos=text(corner + [0, 0, scene.block.height_m - FOOT_M * 10]),
                group=UNSEEN_GROUP,
                rgba=text((*ABS_RED_BLOCK, 1)),
                **scene_bits(),
            )
        for index in range(len(pieces)):
            add(
                body,
                "geom",
                name=f"block{number}_{index}",
                type="mesh",
                mesh=f"block_piece{index}",
                density=text(scene.block.density_kg_m3),
                rgba=text((*ABS_RED_BLOCK, 1)),
                **scene_bits(),
            )
