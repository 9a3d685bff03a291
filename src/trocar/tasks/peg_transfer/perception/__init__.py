"""Perception of the peg transfer: colour and depth of one camera."""

from __future__ import annotations

from trocar.cell import Cell
from trocar.errors import InvalidInput
from trocar.perception.image import Intrinsics
from trocar.tasks.peg_transfer.perception.blocks import find_block, find_held_block
from trocar.tasks.peg_transfer.perception.board import find_board


class DepthView:
    """Finds board and blocks in one RGBD image. A perception of your own needs the same methods.

    Each returns a pose, or one sentence why there is none.
    """

    find_board = staticmethod(find_board)
    find_block = staticmethod(find_block)
    find_held_block = staticmethod(find_held_block)


def depth_camera(cell: Cell) -> str:
    """Return the name of the cell's first camera with depth.

    Raises:
        InvalidInput: there is none.
    """
    for name, camera in cell.cameras.items():
        if isinstance(camera.model, Intrinsics):
            return name
    raise InvalidInput("peg-transfer", "needs an RGBD camera, and this cell has none", "add one to the station")
