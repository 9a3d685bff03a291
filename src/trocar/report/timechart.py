"""When each arm did what: a chart of the spans of a trial."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.patches import Patch

from trocar.errors import TrocarError
from trocar.report import style

COLOURS = {
    "capture": style.SKY,
    "perception": style.PURPLE,
    "planning": style.YELLOW,
    "motion": style.BLUE,
    "settling": style.FAINT,
    "jaw": style.ORANGE,
    "loading": style.GREEN,
}
START, END = -1, sys.maxsize
"""In the place of a transfer: what an arm does before the first one, and after the last."""
SPARE = ("#999933", "#882255", "#44AA99", "#332288", "#AA4499", "#661100")


def draw_timechart(
    spans: Sequence[Mapping[str, Any]], path: Path, title: str = "Time chart", piece: str = "transfer"
) -> Path:
    """Draw one row per transfer and arm, coloured by what was done, and return the path.

    What belongs to no transfer is "start" before the last of them begins and "end" after it.

    Args:
        spans: each with ``arm``, ``name``, ``start_s``, ``end_s`` and ``transfer`` (index; None or -1: none).
        path: of the picture.
        title: above the chart.
        piece: what a row is called.
    """
    if not spans:
        raise TrocarError("a time chart needs at least one span; the trial's log has none")
    names = list(dict.fromkeys(span["name"] for span in spans))
    spare = iter(SPARE * (1 + len(names) // len(SPARE)))
    colours = {name: COLOURS.get(name) or next(spare) for name in names}
    spans_of: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for span, transfer in zip(spans, _transfers(spans), strict=True):
        spans_of.setdefault((transfer, span["arm"]), []).append(span)
    rows = {key: row for row, key in enumerate(sorted(spans_of))}
    several = len({arm for _, arm in rows}) > 1
    with style.figure(9.0, 1.3 + 0.24 * len(rows), path) as figure:
        axes = figure.subplots()
        for key, row in rows.items():
            start = min(span["start_s"] for span in spans_of[key])
            for span in spans_of[key]:
                axes.barh(
                    row,
                    span["end_s"] - span["start_s"],
                    left=span["start_s"] - start,
                    height=0.72,
                    color=colours[span["name"]],
                    edgecolor="white",
                    linewidth=0.4,
                )
            end = max(span["end_s"] for span in spans_of[key]) - start
            axes.text(end, row, f"  {end:.1f} s", va="center", fontsize=8, color=style.QUIET)
        labels = [
            {START: "start", END: "end"}.get(transfer, f"{piece} {transfer + 1}") + (f", {arm}" if several else "")
            for transfer, arm in rows
        ]
        axes.set_yticks(range(len(rows)), labels)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlabel("time since the row began, s")
        axes.margins(x=0.08)
        axes.set_xlim(left=0)
        axes.set_title(title)
        totals = {n: sum(s["end_s"] - s["start_s"] for s in spans if s["name"] == n) for n in names}
        figure.legend(
            handles=[Patch(color=colours[name], label=f"{name}, {totals[name]:.1f} s") for name in names],
            loc="outside lower center",
            ncols=min(6, len(names)),
        )
    return path


def _transfers(spans: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return each span's transfer; START or END where it belongs to none."""
    given = [span.get("transfer") for span in spans]
    indices = [START if index is None else int(index) for index in given]
    last_s = max((s["start_s"] for s, index in zip(spans, indices, strict=True) if index >= 0), default=float("inf"))
    return [
        END if index < 0 and span["start_s"] > last_s else index for span, index in zip(spans, indices, strict=True)
    ]
