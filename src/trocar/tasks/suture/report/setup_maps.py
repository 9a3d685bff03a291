"""Maps of the largest circle that an arm can sew with a needle, over the position of the arm's base."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from trocar.report import style
from trocar.tasks.suture.planning.setup_map import RADII_M, SetupMap

NONE = "#E4E4E4"
PANEL_IN = (2.6, 2.3)


def draw_maps(maps: Mapping[tuple[str, str], SetupMap], path: str | Path) -> Path:
    """Draw one map for each arm (rows) and needle (columns), and return the path of the picture."""
    arms, needles = (list(dict.fromkeys(names)) for names in zip(*maps, strict=True))
    norm = Normalize(0.0, 1e3 * float(RADII_M.max()))
    width, height = PANEL_IN[0] * len(needles) + 1.6, PANEL_IN[1] * len(arms) + 0.9
    with style.figure(width, height, path) as figure:
        grid = figure.subplots(len(arms), len(needles), squeeze=False, sharex=True, sharey=True)
        for row, arm in enumerate(arms):
            for column, needle in enumerate(needles):
                axes, found = grid[row, column], maps[arm, needle]
                axes.set_facecolor(NONE)
                axes.grid(visible=False)
                shown = np.ma.masked_equal(1e3 * found.radius_m, 0.0)
                x, y = 1e3 * found.sideways_m, 1e3 * found.up_m
                axes.pcolormesh(x, y, shown, cmap=style.PATHS, norm=norm, shading="nearest")
                if not found.setups:
                    axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color=style.QUIET)
                title = f"{needle}, {1e3 * found.needle.radius_m:.1f} mm"
                axes.set_title(title if row == 0 else "", fontsize=9)
                if column == 0:
                    axes.set_ylabel(f"{arm}\nbase above, mm", fontsize=8)
                if row == len(arms) - 1:
                    axes.set_xlabel("base beside, mm", fontsize=8)
        colours = ScalarMappable(norm, style.PATHS)
        bar = figure.colorbar(colours, ax=grid, pad=0.02, aspect=24)
        bar.set_label(f"radius of the largest circle, mm (grey: none; none above {norm.vmax:.0f} tried)")
        figure.suptitle("Circles that can be sewn all round, by needle and radius of its curvature", fontsize=10)
    return Path(path)
