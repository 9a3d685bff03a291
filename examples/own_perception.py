"""A perception of your own for the peg transfer: colour and depth, but only what two fits agree on.

trocar run --plugin examples/own_perception.py peg-transfer --perception twice --trials 1 --seed 3 --out out/twice
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trocar.eval import PERCEPTIONS
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.tasks.peg_transfer.perception import DepthView
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

AGREE_M = 0.5e-3
"""Two fits of one block may differ by this."""


class Twice(DepthView):
    """Fits each block to the whole image and to half of its depth; if the fits differ, there is no block."""

    def find_block(self, image: RgbdImage, T_camera_board: SE3, board: Pegboard, block: Block, peg: int) -> SE3 | str:
        """Return the block's pose if both fits agree, or why not."""
        depth = image.depth_m.copy()
        depth[:, ::2] = np.nan
        images = image, replace(image, depth_m=depth)
        whole, half = (super(Twice, self).find_block(one, T_camera_board, board, block, peg) for one in images)
        if isinstance(whole, str) or isinstance(half, str):
            return whole if isinstance(whole, str) else half
        apart = np.linalg.norm(whole.translation_m - half.translation_m)
        return f"two fits lie {1e3 * apart:.1f} mm apart" if apart > AGREE_M else whole


PERCEPTIONS.register("peg-transfer/twice", Twice)
