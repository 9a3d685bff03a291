"""Two runs side by side, with the difference over the sessions that both have."""

from __future__ import annotations

from html import escape
from typing import Any

from trocar.counting import counted
from trocar.errors import InvalidInput
from trocar.eval import in_words
from trocar.eval.comparison import Difference
from trocar.eval.trials import Comparison, compared
from trocar.report.browse import addresses
from trocar.report.browse.cells import figure_of, how_many, success
from trocar.report.browse.shelf import Run
from trocar.report.page import Column, document, link, listing, paragraph, section
from trocar.report.tables import failure_counts

SETTINGS = ("variant", "method", "model", "calibration", "prior", "planner", "perception", "set", "options", "seed")
"""Settings in which two runs may differ; only those in which they do are shown."""
EXPLAINED = (
    "Differences, first run minus second, are means over the sessions that both have, with their 95 % intervals. p is "
    "the probability of one at least as far in favour of the first by chance."
)


def two_runs_page(one: Run, two: Run) -> str:
    """Return the page of two runs, the first minus the second."""
    problem, found = "", None
    if one.trials and two.trials:
        try:
            found = compared(one.trials, two.trials)
        except InvalidInput as error:
            problem = f"No difference can be stated: {error}."
    else:
        problem = "No difference can be stated: a run without finished trials has nothing to compare."
    shared = found.success_rate.sessions if found is not None else 0
    if found is not None and not shared:
        problem, found = "No difference can be stated: the runs have no session in common.", None
    both = (link(addresses.of_run(run), run.name) for run in (one, two))
    parts = [
        f"<nav>{link(addresses.ALL, 'All runs')}{''.join(both)}{link(addresses.of_pair(two, one), 'Swap')}</nav>",
        paragraph(problem, "warning") if problem else "",
        section("figures", "In numbers", _figures(one, two, found), paragraph(EXPLAINED, "quiet") if found else ""),
        section("failures", "Failures", *_failures(one, two)),
        section("sessions", "Session by session", *(_sessions(one, two) if found else [])),
    ]
    over = f"The difference over the {counted(shared, 'session')} that both have." if found else "Side by side."
    return document(f"{one.name} beside {two.name}", [over], parts)


def _figures(one: Run, two: Run, found: Comparison | None) -> str:
    rows: list[list[str]] = [
        [key, *(escape(_setting(run, key)) for run in (one, two)), ""]
        for key in ("task", *SETTINGS)
        if key in ("task", "method") or _setting(one, key) != _setting(two, key)
    ]
    rows += [
        ["difficulty", escape(one.difficulty), escape(two.difficulty), ""],
        ["version", escape(one.version), escape(two.version), ""],
        ["sessions × trials", how_many(one), how_many(two), ""],
        ["success", success(one), success(two), _difference(found and found.success_rate, 100.0, "points")],
        ["s per goal", *(figure_of(run, "mean_time_s") for run in (one, two)), _difference(found and found.time_s)],
        [
            "collisions per trial",
            *(figure_of(run, "collisions_per_trial") for run in (one, two)),
            _difference(found and found.collisions),
        ],
    ]
    return listing([Column("what"), Column(one.name), Column(two.name), Column("difference")], rows)


def _setting(run: Run, key: str) -> str:
    value: Any = run.about.get(key)
    if isinstance(value, dict):
        return ", ".join(f"{name} {one}" for name, one in value.items() if one is not None)
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value or "")


def _difference(found: Difference | None, scale: float = 1.0, unit: str = "") -> str:
    """Return a difference with its interval and p, in HTML; empty if there is none."""
    if found is None:
        return ""
    number = f"+.{1 if scale > 1 else 2}f"
    mean = f"{scale * found.mean:{number}}{f' {unit}' if unit else ''}"
    if found.low is None or found.high is None:
        spread = "one session"
    else:
        spread = f"{scale * found.low:{number}} to {scale * found.high:{number}}"
    return f"<span class=whole><b>{mean}</b> <span class=quiet>({spread}), p {found.p:.3f}</span></span>"


def _failures(one: Run, two: Run) -> list[str]:
    """Return how often each failure occurred in each run."""
    counts = [failure_counts(score for trial in run.trials for score in trial.scores) for run in (one, two)]
    names = sorted(set().union(*counts), key=lambda name: (-sum(count[name] for count in counts), name))
    if not names:
        return []
    rows = [[escape(in_words(name)), *(str(count[name]) for count in counts)] for name in names]
    heads = (f"{run.name}, of {run.figures['attempted'] if run.figures else 0}" for run in (one, two))
    return [listing([Column("failure"), *(Column(head, number=True) for head in heads)], rows)]


def _sessions(one: Run, two: Run) -> list[str]:
    """Return how many goals were reached in each session of both runs, the largest difference first."""
    found = [_by_session(run) for run in (one, two)]
    both = [session for session in found[0] if session in found[1]]
    gained = {s: found[0][s][0] / max(found[0][s][1], 1) - found[1][s][0] / max(found[1][s][1], 1) for s in both}
    rows = []
    for session in sorted(both, key=lambda s: (-round(abs(gained[s]), 9), s)):
        cells = []
        for run, of_run in zip((one, two), found, strict=True):
            succeeded, goals, index = of_run[session]
            cells.append(link(addresses.of_trial(run, session, index), f"{succeeded} of {goals}"))
        rows.append([f"session {session}", *cells, f"{100 * gained[session]:+.1f}"])
    heads = (Column(run.name) for run in (one, two))
    hint = paragraph("A click plays the session's first trial with a failure.", "quiet")
    return [hint, listing([Column("session"), *heads, Column("difference, points", number=True)], rows)]


def _by_session(run: Run) -> dict[int, tuple[int, int, int]]:
    """Return for each session the goals reached, the number of goals, and its first trial with a failure, if any."""
    found: dict[int, tuple[int, int, int]] = {}
    failing: set[int] = set()
    for trial in run.trials:
        session, index = trial.about["session"], trial.about["index"]
        reached = sum(bool(score["succeeded"]) for score in trial.scores)
        succeeded, goals, shown = found.get(session, (0, 0, index))
        if reached < len(trial.scores) and session not in failing:
            failing.add(session)
            shown = index
        found[session] = succeeded + reached, goals + len(trial.scores), shown
    return found
