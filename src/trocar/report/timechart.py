"""Who did what when: the parts and turns of a trial's arms, drawn over time."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import inf
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from trocar.errors import InvalidInput
from trocar.eval.trial import Trial
from trocar.eval.turns import Turn, turn_at, turns_of
from trocar.log import Span
from trocar.report import style

OTHER = "other"  # name of the time in which a script noted nothing


def parts_of(spans: Sequence[Span], arm: str, duration_s: float) -> dict[str, float]:
    """Return the time in s that one arm spent on each part; they add up to the duration of the trial.

    Where spans of the arm overlap, such as when jaws open during a motion, the moment counts for the one that began
    first (of those that began together, the longest).
    """
    mine = sorted(
        (max(0.0, s.start_s), -min(s.end_s, duration_s), s.name) for s in spans if s.arm == arm and s.end_s > s.start_s
    )
    parts: dict[str, float] = {}
    counted_s = 0.0
    for start_s, minus_end_s, name in mine:
        seconds = -minus_end_s - max(start_s, counted_s)
        if seconds > 0:
            parts[name] = parts.get(name, 0.0) + seconds
            counted_s = -minus_end_s
    parts[OTHER] = max(0.0, duration_s - sum(parts.values()))  # sums of floats leave -1e-15 s
    return parts


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
"""Pseudo goals for what an arm does before its first goal, between two of its own, and after its last."""
NO_GOAL = {START: "start", BETWEEN: "between", END: "end"}
SIZE_IN, ROW_IN = (9.0, 1.3), 0.24  # width and height without rows; height of a row
LONG = 20  # six labels of this many letters fit beside each other
OVERLAP = 0.25  # an overlap of less than this share of a part's time is not mentioned
SPARE = ("#999933", "#882255", "#44AA99", "#332288", "#AA4499", "#661100")


def draw_timechart(trial: Trial, path: str | Path, title: str = "Time chart") -> Path:
    """Draw :func:`chart` of a trial and return the path."""
    with style.figure(*SIZE_IN, path) as figure:
        chart(figure, trial, title)
    return Path(path)


def chart(figure: Figure, trial: Trial, title: str = "Time chart") -> None:
    """Draw one row per goal and arm, coloured by what was done; the figure grows with the rows.

    Spans without a goal are in the rows "start" before an arm's first goal, "end" after its last one, and otherwise
    "between", where pauses are left out. The legend counts each moment of an arm once (``parts_of``); bars may overlap.
    """
    spans, turns, piece = sorted(trial.spans, key=lambda span: span.start_s), turns_of(trial), trial.goal_noun
    if not spans:
        raise InvalidInput("a time chart", "needs at least one span", "the trial's log has none")
    names = list(dict.fromkeys(span.name for span in spans))
    spare = iter(SPARE * (1 + len(names) // len(SPARE)))
    colours = {name: COLOURS.get(name) or next(spare) for name in names}
    spans_of: dict[tuple[int, str], list[Span]] = {}
    for span in spans:
        spans_of.setdefault((_goal_of(span, turns), span.arm), []).append(span)
    rows = {key: row for row, key in enumerate(sorted(spans_of))}
    several = len({arm for _, arm in rows}) > 1
    width, height = SIZE_IN
    figure.set_size_inches(width, height + ROW_IN * len(rows))
    axes = figure.subplots()
    for key, row in rows.items():
        end = 0.0
        for span in spans_of[key]:
            lasted = span.end_s - span.start_s
            left = end if key[0] == BETWEEN else span.start_s - spans_of[key][0].start_s
            axes.barh(row, lasted, left=left, height=0.72, color=colours[span.name], edgecolor="white", linewidth=0.4)
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
    parts = [parts_of(spans, arm, trial.duration_s) for arm in dict.fromkeys(span.arm for span in spans)]
    totals = {name: sum(of_arm.get(name, 0.0) for of_arm in parts) for name in names}
    noted = {name: sum(s.end_s - s.start_s for s in spans if s.name == name) for name in names}
    parts_said = {name: _label(name, totals[name], noted[name]) for name in names}
    figure.legend(
        handles=[Patch(color=colours[name], label=label) for name, label in parts_said.items()],
        loc="outside lower center",
        ncols=4 if max(map(len, parts_said.values())) > LONG else min(6, len(names)),
        fontsize=8,
        title="in all, each moment of an arm counted once; meanwhile: while something that began before went on",
        title_fontsize=8,
    )


def _label(name: str, alone_s: float, noted_s: float) -> str:
    """Return a part with its time, and how much of it overlapped with spans that had begun before."""
    meanwhile = f" (+ {noted_s - alone_s:.1f} s meanwhile)" if noted_s - alone_s > OVERLAP * noted_s else ""
    return f"{name}, {alone_s:.1f} s{meanwhile}"


def _goal_of(span: Span, turns: list[Turn]) -> int:
    """Return the number of the goal that a span belongs to; START, BETWEEN or END if it has none."""
    turn = turn_at(turns, span.arm, span.start_s)
    if turn is not None:
        return turn.goal
    mine = [turn for turn in turns if turn.arm in (None, span.arm)]
    if span.start_s < min((turn.start_s for turn in mine), default=inf):
        return START
    return END if span.start_s >= max(turn.end_s for turn in mine) else BETWEEN
