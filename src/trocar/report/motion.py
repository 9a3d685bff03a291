"""A recorded motion over time: position, velocity, acceleration, jerk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trocar.motion.analysis import Derivatives
from trocar.report import style

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY)
KINDS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"), ("jerk", "/s³"))


def draw_motion(parts: Mapping[str, tuple[Sequence[str], Derivatives]], path: str | Path) -> Path:
    """Draw each part (joints, tip) as a column of four charts, and return the path.

    Args:
        parts: name to the signals' names and their motion.
        path: of the picture.
    """
    path = Path(path)
    with style.figure(5.2 * len(parts), 7.6, path) as figure:
        grid = figure.subplots(len(KINDS), len(parts), sharex=True, squeeze=False)
        for column, (part, (names, found)) in enumerate(parts.items()):
            times_s = found.step_s * np.arange(len(found.position))
            unit = "m" if part == "tip" else "rad or m"
            for axes, (kind, per) in zip(grid[:, column], KINDS, strict=True):
                rows = getattr(found, kind)
                for k, name in enumerate(names):
                    axes.plot(times_s[: len(rows)], rows[:, k], linewidth=0.8, color=COLOURS[k % 6], label=name)
                axes.set_ylabel(f"{kind}, {f'({unit}){per}' if per and part != 'tip' else unit + per}")
            grid[0, column].set_title("Tool tip in the arm's base frame" if part == "tip" else "Joints")
            grid[0, column].legend(ncols=6, fontsize=7)
            grid[-1, column].set_xlabel("s")
    return path
