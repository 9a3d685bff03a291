"""Time per fragment by part, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.report import style
from trocar.report.timechart import COLOURS
from trocar.tasks.debridement.report.table_one import PARTS, PERSON, TABLE_1

WAITING = style.QUIET


def draw_times(ours: Sequence[tuple[str, str, Mapping[str, Any]]], path: Path) -> Path:
    """Draw the time per fragment as stacked bars with its 95 % interval, and return the path.

    Args:
        ours: variant, method and figures of each condition.
        path: of the picture.
    """
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
        for row, (label, parts, total) in enumerate(bars):
            left = 0.0
            paper = label.startswith("paper")
            for part in PARTS:
                axes.barh(
                    row,
                    parts.get(part, 0.0),
                    left=left,
                    height=0.7,
                    color=COLOURS.get(part, WAITING),
                    alpha=0.55 if paper else 1.0,
                    label=part if row == 1 else None,
                )
                left += parts.get(part, 0.0)
            if not parts:
                axes.barh(row, total["mean"], height=0.7, color=style.FAINT, edgecolor=style.QUIET, linewidth=0.6)
            end = total["mean"]
            if total["low"] is not None:
                error = [[end - total["low"]], [total["high"] - end]]
                axes.errorbar(end, row, xerr=error, color=style.INK, capsize=3, linewidth=1.0)
                end = total["high"]
            axes.text(end, row, f"  {total['mean']:.1f} s", va="center", fontsize=8, color=style.QUIET)
        axes.set_yticks(range(len(bars)), [label for label, _, _ in bars])
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlim(
            0.0, 1.1 * max(total["high"] if total["low"] is not None else total["mean"] for _, _, total in bars)
        )
        axes.set_xlabel("s per cleared fragment; ours simulated, with 95 % intervals")
        axes.set_title("Time per fragment by part")
        figure.legend(loc="outside lower center", ncols=len(PARTS))
    return path
