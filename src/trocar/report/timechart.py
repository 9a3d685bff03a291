"""When each arm did what: a chart of the spans of a trial."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.patches import Patch

from trocar.errors import TrocarError
from trocar.report import style
from trocar.trials.trial import Trial

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
"""In the place of a goal: what an arm does before the first one, and after the last."""
SPARE = ("#999933", "#882255", "#44AA99", "#332288", "#AA4499", "#661100")


def draw_timechart(trial: Trial, path: Path, title: str = "Time chart") -> Path:
    """Draw one row per goal and arm, coloured by what was done, and return the path.

    What belongs to no goal is "start" before the last of them begins and "end" after it; goals are numbered in the
    order of the scores or, where scripts note which arm had which, in that in which they ended.

    Args:
        trial: whose spans and scores.
        path: of the picture.
        title: above the chart.
    """
    spans = _with_goals(trial)
    piece = trial.piece
    if not spans:
        raise TrocarError("a time chart needs at least one span; the trial's log has none")
    names = list(dict.fromkeys(span["name"] for span in spans))
    spare = iter(SPARE * (1 + len(names) // len(SPARE)))
    colours = {name: COLOURS.get(name) or next(spare) for name in names}
    spans_of: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for span in spans:
        spans_of.setdefault((span["goal"], span["arm"]), []).append(span)
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
            {START: "start", END: "end"}.get(goal, f"{piece} {goal + 1}") + (f", {arm}" if several else "")
            for goal, arm in rows
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


def _with_goals(trial: Trial) -> list[dict[str, Any]]:
    """Return a trial's spans as dicts with the number of the goal that each belongs to; START or END where to none.

    Where scripts note of each piece which arm had it and since when, spans go by that: arms that work side by side
    have goals that overlap. Else they go by the scores.
    """
    noted = [event for event in trial.events if event["name"] == trial.piece and {"arm", "start_s"} <= event.keys()]
    goals = [(event["arm"], float(event["start_s"]), float(event["time_s"])) for event in noted] or [
        (None, float(score["start_s"]), float(score["end_s"])) for score in trial.scores
    ]
    found = []
    for span in trial.spans:
        mine = [(number, *times) for number, (arm, *times) in enumerate(goals) if arm in (None, span.arm)]
        goal = END if span.start_s > max((start_s for _, start_s, _ in mine), default=float("inf")) else START
        for number, start_s, end_s in mine:
            if start_s - 1e-9 <= span.start_s < end_s - 1e-9:
                goal = number
        found.append({**vars(span), "goal": goal})
    return found
