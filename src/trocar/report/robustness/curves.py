"""Success and collisions against the size of each flaw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.report import style

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
WIDTH_IN, HEIGHT_IN = 2.7, 4.4


def draw_curves(summaries: Sequence[Mapping[str, Any]], path: str | Path) -> Path:
    """Draw a column for each flaw, success above collisions, a curve for each method; return the path.

    Args:
        summaries: of the conditions.
        path: of the picture.
    """
    path = Path(path)
    flaws, methods = (list(dict.fromkeys(row[key] for row in summaries)) for key in ("flaw", "method"))
    with style.figure(1.0 + WIDTH_IN * len(flaws), HEIGHT_IN, path) as figure:
        grid = figure.subplots(2, len(flaws), squeeze=False, sharex="col", sharey="row")
        for column, flaw in enumerate(flaws):
            top, bottom = grid[:, column]
            for method, colour in zip(methods, COLOURS * len(methods), strict=False):
                rows = [row for row in summaries if row["flaw"] == flaw and row["method"] == method]
                x = [row["size"] for row in rows]
                rates = [100 * row["success"] for row in rows]
                low, high = ([100 * row["success_ci95"][end] for row in rows] for end in (0, 1))
                top.plot(x, rates, "o-", color=colour, markersize=3.5, label=method if column == 0 else None)
                top.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
                hits = [row["collisions_per_trial"] for row in rows]
                bottom.plot(x, [hit["mean"] for hit in hits], "o-", color=colour, markersize=3.5)
                if all(hit["low"] is not None for hit in hits):
                    ends = ([max(hit["low"], 0.0) for hit in hits], [hit["high"] for hit in hits])
                    bottom.fill_between(x, *ends, color=colour, alpha=0.15, linewidth=0)
            unit = next(row["unit"] for row in summaries if row["flaw"] == flaw)
            varied = [row for row in summaries if row["flaw"] == flaw and row["scale"] > 0]
            recorded = varied[0]["size"] / varied[0]["scale"] if varied else None
            for axes in (top, bottom):
                if recorded is not None:
                    axes.axvline(recorded, color=style.QUIET, linewidth=0.8, linestyle=":")
            top.set_title(flaw)
            bottom.set_xlabel("times what was recorded" if unit == "x" else unit)
        grid[0, 0].set_ylim(0.0, 102.0)
        grid[1, 0].set_ylim(bottom=0.0)
        grid[0, 0].set_ylabel("goals reached, %")
        grid[1, 0].set_ylabel("collisions per trial")
        figure.legend(
            loc="outside lower center",
            ncols=len(methods),
            title="shaded: 95 % interval over sessions",
            title_fontsize=8,
        )
    return path
