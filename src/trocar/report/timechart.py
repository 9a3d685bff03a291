"""When each arm did what: a chart of the spans of a trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.patches import Patch

from trocar.errors import TrocarError
from trocar.report import style

COLOURS = {
    "capture": style.SKY,
    "perceive": style.PURPLE,
    "plan": style.YELLOW,
    "move": style.BLUE,
    "grasp": style.ORANGE,
    "release": style.VERMILION,
    "check": style.GREEN,
    "wait": style.FAINT,
}
SPARE = ("#999933", "#882255", "#44AA99", "#332288", "#AA4499", "#661100")


def draw_timechart(spans: Sequence[Mapping[str, Any]], path: Path, title: str = "Time chart") -> Path:
    """Draw one row per transfer and arm, coloured by what was done, and return the path.

    Args:
        spans: each with ``arm``, ``name``, ``start_s``, ``end_s`` and ``transfer`` (index, or None).
        path: of the picture.
        title: above the chart.
    """
    if not spans:
        raise TrocarError("a time chart needs at least one span; the trial's log has none")
    names = list(dict.fromkeys(span["name"] for span in spans))
    spare = iter(SPARE * (1 + len(names) // len(SPARE)))
    colours = {name: COLOURS.get(name) or next(spare) for name in names}
    known = {(_transfer(span), span["arm"]) for span in spans}
    rows = {key: row for row, key in enumerate(sorted(known))}
    several = len({arm for _, arm in rows}) > 1
    with style.figure(9.0, 1.3 + 0.24 * len(rows), path) as figure:
        axes = figure.subplots()
        starts = {key: min(s["start_s"] for s in spans if (_transfer(s), s["arm"]) == key) for key in rows}
        for span in spans:
            key = (_transfer(span), span["arm"])
            length = span["end_s"] - span["start_s"]
            axes.barh(
                rows[key],
                length,
                left=span["start_s"] - starts[key],
                height=0.72,
                color=colours[span["name"]],
                edgecolor="white",
                linewidth=0.4,
            )
        for key, row in rows.items():
            end = max(s["end_s"] for s in spans if (_transfer(s), s["arm"]) == key) - starts[key]
            axes.text(end, row, f"  {end:.1f} s", va="center", fontsize=8, color=style.QUIET)
        labels = [
            ("start" if transfer < 0 else f"transfer {transfer + 1}") + (f", {arm}" if several else "")
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


def _transfer(span: Mapping[str, Any]) -> int:
    """Return the span's transfer, -1 where it belongs to none."""
    index = span.get("transfer")
    return -1 if index is None else int(index)
