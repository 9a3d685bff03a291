"""Failure modes as bars with intervals, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trocar.report import style
from trocar.tasks.debridement.report.published import MODES, PERSON, TABLE_1

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY)


def draw_failures(ours: Sequence[tuple[str, str, Mapping[str, Any]]], path: Path) -> Path:
    """Draw the rate of each failure mode with its 95 % interval, one panel for each number of arms; return the path.

    Args:
        ours: variant, method and figures of each condition.
        path: of the picture.
    """
    variants = list(dict.fromkeys(variant for variant, _, _ in ours))
    methods = list(dict.fromkeys(method for _, method, _ in ours))
    with style.figure(4.6 * len(variants) + 1.6, 5.2, path) as figure:
        grid = figure.subplots(1, len(variants), sharey=True, sharex=True, squeeze=False)[0]
        at = np.arange(len(MODES), dtype=np.float64)
        for axes, variant in zip(grid, variants, strict=True):
            bars = [
                (method, COLOURS[methods.index(method) % len(COLOURS)], [_ours(figures, mode) for mode in MODES])
                for name, method, figures in ours
                if name == variant
            ]
            published = [
                (column.who.split(",")[0], colour, [(column.rate(mode), *column.interval(mode)) for mode in MODES])
                for column, colour in ((TABLE_1[variant], style.INK), (PERSON, "#A9A9A9"))
            ]
            rows = [*((f"paper: {who}", colour, rates) for who, colour, rates in published), *bars]
            height = 0.8 / len(rows)
            for place, (label, colour, rates) in enumerate(rows):
                y = at + (place - (len(rows) - 1) / 2) * height
                rate, low, high = 100.0 * np.array(rates).T
                axes.barh(y, rate, 0.9 * height, color=colour, label=label, alpha=0.85)
                axes.errorbar(
                    rate,
                    y,
                    xerr=[rate - low, high - rate],
                    fmt=".",
                    color=colour,
                    capsize=2,
                    linewidth=0.9,
                    markersize=4,
                )
            axes.set_title(variant.replace("-", " "))
            axes.set_xlabel("%, with 95 % interval")
            axes.grid(axis="y", visible=False)
        grid[0].set_yticks(at, list(MODES.values()))
        grid[0].invert_yaxis()
        grid[0].set_xlim(left=0.0)
        handles = {
            label: handle for axes in grid for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=len(handles))
    return path


def _ours(figures: Mapping[str, Any], mode: str) -> tuple[float, float, float]:
    rate = figures["failure_modes"][mode]
    if rate["rate"] is None:
        return np.nan, np.nan, np.nan
    low, high = rate["ci95"]
    return rate["rate"], low, high
