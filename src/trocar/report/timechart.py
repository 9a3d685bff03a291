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
START, BETWEEN, END = -1, sys.maxsize - 1, sys.maxsize
"""In the place of a goal: what an arm does before its first one, between two of its own, and after its last."""
NO_GOAL = {START: "start", BETWEEN: "between", END: "end"}
SPARE = ("#999933", "#882255", "#44AA99", "#332288", "#AA4499", "#661100")


def draw_timechart(trial: Trial, path: Path, title: str = "Time chart") -> Path:
    """Draw one row per goal and arm, coloured by what was done, and return the path.

    What belongs to no goal is "start" before an arm's first one, "end" after its last one, and "between" them, where
    pauses are left out. Goals are numbered in the order of the scores or, where scripts note which arm had which, in
    that in which they ended.

    Args:
        trial: whose spans and scores.
        path: of the picture.
        title: above the chart.
    """
    spans = sorted(_with_goals(trial), key=lambda span: span["start_s"])
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
            end = 0.0
            for span in spans_of[key]:
                lasted = span["end_s"] - span["start_s"]
                left = end if key[0] == BETWEEN else span["start_s"] - spans_of[key][0]["start_s"]
                axes.barh(
                    row,
                    lasted,
                    left=left,
                    height=0.72,
                    color=colours[span["name"]],
                    edgecolor="white",
                    linewidth=0.4,
                )
                end = max(end, left + lasted)
            axes.text(end, row, f"  {end:.1f} s", va="center", fontsize=8, color=style.QUIET)
        labels = [NO_GOAL.get(goal, f"{piece} {goal + 1}") + (f", {arm}" if several else "") for goal, arm in rows]
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
        goal = BETWEEN
        if not mine or span.start_s < min(start_s for _, start_s, _ in mine):
            goal = START
        elif span.start_s >= max(end_s for _, _, end_s in mine):
            goal = END
        for number, start_s, end_s in mine:
            if start_s - 1e-9 <= span.start_s < end_s - 1e-9:
                goal = number
        found.append({**vars(span), "goal": goal})
    return found
