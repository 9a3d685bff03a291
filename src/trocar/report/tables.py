"""Tables of a run for the terminal and for its page, and the active flaws."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table

from trocar.counting import counted
from trocar.eval import PaperCount, PaperRow
from trocar.eval.config import FITTED_ON
from trocar.eval.statistics import wilson_interval


def table_of(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str = "",
    caption: str = "",
    right: Collection[str] = (),
) -> Table:
    """Return a table for the terminal and for a page (``page.table``); ``right`` names the columns of numbers."""
    table = Table(title=title, caption=caption)
    for name in head:
        table.add_column(name, justify="right" if name in right else "left")
    for row in rows:
        table.add_row(*row)
    return table


def brief_flaws(flaws: Mapping[str, str]) -> str:
    """Return the difficulty of a run's laboratory and only what differs from it; ``flaws`` as in ``summary.json``."""
    level, *named = flaws["difficulty"].split(", ")
    said = [f"difficulty {level}" + (f" except for {', '.join(named)}" if named else "")]
    said += [f"{what} {how}" for what, how in flaws.items() if how == "switched off"]
    if FITTED_ON in flaws:
        said.append(f"{FITTED_ON} {flaws[FITTED_ON]}")
    return f"laboratory: {'; '.join(said)}; summary.json has the size of every flaw"


def run_table(summary: Mapping[str, Any], paper: Sequence[PaperRow] = (), theirs: PaperCount | None = None) -> Table:
    """Return the table of a run, with published rows under it, first those of its own method.

    Args:
        summary: keys as in ``summary.json``.
        paper: rows of a paper; their intervals treat every attempt as independent, because nothing else was published.
        theirs: our run counted as in the paper, if that differs.
    """
    how_many = f"{counted(summary['trials'], 'trial')} in {counted(summary['sessions'], 'session')}"
    numbers = (summary["goal_noun"] + "s", "success", "95 % interval", "mean time s")
    table = table_of(
        ("who", *numbers),
        (),
        title=", ".join(text for text in (summary["task"], summary["variant"], how_many, "simulated") if text),
        caption="intervals of our rows count sessions" + ("; the paper's count attempts" if paper else ""),
        right=numbers,
    )
    ours = _successes(summary["succeeded"], summary["attempted"], tuple(summary["success_ci95"]))
    table.add_row(f"trocar, {_method(summary)}", *ours, figure(summary["mean_time_s"]), style="bold")
    if theirs is not None:
        table.add_row(f"the same, {theirs.how}", *_successes(theirs.succeeded, theirs.attempted, theirs.ci95), "")
    if paper:
        table.add_section()
    for row in sorted(paper, key=lambda row: summary["method"] not in row.methods):
        published = _successes(row.succeeded, row.attempted, wilson_interval(row.succeeded, row.attempted))
        look = "" if summary["method"] in row.methods else "dim"
        table.add_row(f"paper: {row.who}", *published, figure(row.mean_time_s), style=look)
    return table


def headline(summary: Mapping[str, Any]) -> str:
    """Return a run in one sentence: how much of it succeeded, and how certain that is."""
    low, high = summary["success_ci95"]
    return (
        f"{summary['task']}, {_method(summary)}: {summary['succeeded']} of "
        f"{counted(summary['attempted'], summary['goal_noun'])}, 95 % interval {percent(low)} to {percent(high)}, in "
        f"{counted(summary['trials'], 'trial')} of {counted(summary['sessions'], 'session')}"
    )


def parts_table(summary: Mapping[str, Any]) -> Table:
    """Return the time per goal, part by part."""
    parts = summary["parts_s"]
    total = sum(parts.values()) or 1.0
    rows = [
        (name, f"{seconds:z.2f}", percent(seconds / total))
        for name, seconds in sorted(parts.items(), key=lambda item: -item[1])
    ]
    title = f"Mean {summary['goal_noun']}, part by part"
    return table_of(("part", "s", "share"), rows, title=title, right=("s", "share"))


def figure(value: float | None) -> str:
    """Return a number with two decimals as text, a dash where there is none."""
    return "-" if value is None else f"{value:.2f}"


def percent(share: float | None) -> str:
    """Return a share as text, a dash where there is none."""
    return "-" if share is None else f"{100 * share:z.1f} %"


def _method(summary: Mapping[str, Any]) -> str:
    return f"{summary['method']} ({summary['model']})" if summary.get("model") else summary["method"]


def _successes(succeeded: int, attempted: int, interval: tuple[float, float]) -> tuple[str, str, str]:
    """Return count, rate and interval as text."""
    rate = succeeded / attempted if attempted else None
    return f"{succeeded} of {attempted}", percent(rate), f"{percent(interval[0])} to {percent(interval[1])}"
