"""Pictures of debridement: time per fragment by part, and failure modes, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trocar.report import style
from trocar.report.timechart import COLOURS
from trocar.tasks.debridement.report.table_one import MODES, PARTS, PERSON, TABLE_1

Figures = Sequence[tuple[str, str, Mapping[str, Any]]]
"""Variant, method and figures of each condition."""


def draw_times(ours: Figures, path: Path) -> Path:
    """Draw the time per fragment as stacked bars with its 95 % interval, and return the path."""
    bars: list[tuple[str, Mapping[str, float], Mapping[str, Any]]] = [
        (f"paper: {PERSON.who}", {}, {"mean": PERSON.s_per_fragment, "low": None})
    ]
    for variant, column in TABLE_1.items():
        mine = [(method, figures) for name, method, figures in ours if name == variant and figures["s_per_fragment"]]
        if mine:
            bars.append((f"paper: {column.who}", column.parts_s, {"mean": column.s_per_fragment, "low": None}))
        words = variant.replace("-", " ")
        bars += [(f"{words}, {method}", f["table_parts_s"], f["s_per_fragment"]) for method, f in mine]
    with style.figure(8.6, 1.3 + 0.36 * len(bars), path) as figure:
        axes = figure.subplots()
        longest = 0.0
        for row, (label, parts, total) in enumerate(bars):
            alpha, left = 0.55 if label.startswith("paper") else 1.0, 0.0
            for part in PARTS:
                look = {"color": COLOURS.get(part, style.QUIET), "alpha": alpha, "label": part if row == 1 else None}
                axes.barh(row, parts.get(part, 0.0), left=left, height=0.7, **look)
                left += parts.get(part, 0.0)
            end = total["mean"]
            if not parts:
                axes.barh(row, end, height=0.7, color=style.FAINT, edgecolor=style.QUIET, linewidth=0.6)
            if total["low"] is not None:
                error = [[end - total["low"]], [total["high"] - end]]
                axes.errorbar(end, row, xerr=error, color=style.INK, capsize=3, linewidth=1.0)
                end = total["high"]
            axes.text(end, row, f"  {total['mean']:.1f} s", va="center", fontsize=8, color=style.QUIET)
            longest = max(longest, end)
        axes.set_yticks(range(len(bars)), [label for label, _, _ in bars])
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlim(0.0, 1.1 * longest)
        axes.set_xlabel("s per cleared fragment; ours simulated, with 95 % intervals")
        axes.set_title("Time per fragment by part")
        figure.legend(loc="outside lower center", ncols=len(PARTS))
    return path


def draw_failures(ours: Figures, path: Path) -> Path:
    """Draw the rates of the failure modes with 95 % intervals, a panel for each number of arms; return the path."""
    variants = list(dict.fromkeys(variant for variant, _, _ in ours))
    methods = list(dict.fromkeys(method for _, method, _ in ours))
    with style.figure(4.6 * len(variants) + 1.6, 5.2, path) as figure:
        grid = figure.subplots(1, len(variants), sharey=True, sharex=True, squeeze=False)[0]
        at = np.arange(len(MODES), dtype=np.float64)
        for axes, variant in zip(grid, variants, strict=True):
            rows = [
                (f"paper: {column.who.split(',')[0]}", colour, [(column.rate(m), *column.interval(m)) for m in MODES])
                for column, colour in ((TABLE_1[variant], style.INK), (PERSON, "#A9A9A9"))
            ]
            rows += [
                (method, style.SERIES[methods.index(method) % len(style.SERIES)], [_rate(f, m) for m in MODES])
                for name, method, f in ours
                if name == variant
            ]
            height = 0.8 / len(rows)
            for place, (label, colour, rates) in enumerate(rows):
                y = at + (place - (len(rows) - 1) / 2) * height
                rate, low, high = 100.0 * np.array(rates).T
                axes.barh(y, rate, 0.9 * height, color=colour, label=label, alpha=0.85)
                look = {"fmt": ".", "color": colour, "capsize": 2, "linewidth": 0.9, "markersize": 4}
                axes.errorbar(rate, y, xerr=[rate - low, high - rate], **look)
            axes.set_title(variant.replace("-", " "))
            axes.set_xlabel("%, with 95 % interval")
            axes.grid(axis="y", visible=False)
        grid[0].set_yticks(at, list(MODES.values()))
        grid[0].invert_yaxis()
        grid[0].set_xlim(left=0.0)
        named = {label: bar for axes in grid for bar, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=len(named))
    return path


def _rate(figures: Mapping[str, Any], mode: str) -> tuple[float, float, float]:
    rate = figures["failure_modes"][mode]
    return (np.nan, np.nan, np.nan) if rate["rate"] is None else (rate["rate"], *rate["ci95"])
