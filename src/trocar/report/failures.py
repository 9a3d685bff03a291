"""What failed in a run, and the list that leads from each failure to its moment in a replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import chain, groupby, zip_longest

from trocar.counting import counted
from trocar.eval import TaskReport, in_words
from trocar.eval.trial import Trial
from trocar.report.page import Column, link, listing, paragraph
from trocar.report.tables import goal_name, reason_of

MOST = 100
"""Maximum number of failed goals in the list; of more, some of each kind are shown."""
REPLAY = "replay.html"
LEAD_S = 2.0
"""A replay starts this long before the requested moment, so that the viewer sees what leads to it."""


def of_moment(time_s: float) -> str:
    """Return the address of a replay that begins shortly before a time, from the folder in which it lies."""
    return f"{REPLAY}#t={max(0.0, time_s - LEAD_S):.2f}"


def place_of(trial: Trial) -> str:
    """Return which trial it is, in words."""
    return f"session {trial.about['session']}, trial {trial.about['index']}"


@dataclass(frozen=True)
class Failed:
    """One goal that was not reached; ``place``: index of its trial among the run's; ``what``: the goal in words."""

    place: int
    session: int
    trial: int
    number: int
    failure: str
    what: str
    reason: str

    def __str__(self) -> str:
        return f"session {self.session}, trial {self.trial}, {self.what}: {in_words(self.failure)}"

    @property
    def stem(self) -> str:
        """Return the name of its picture's file."""
        return f"session_{self.session:02d}_trial_{self.trial:03d}_goal_{self.number + 1:02d}"


def failed_goals(trials: Sequence[Trial], report: TaskReport) -> list[Failed]:
    """Return all goals that were attempted and not reached, in order."""
    found = []
    for place, trial in enumerate(trials):
        session, index = trial.about["session"], trial.about["index"]
        for number, score in enumerate(trial.scores):
            if score["attempted"] and not score["succeeded"]:
                failure, what = str(score["failure"]), goal_name(trial, number, report)
                found.append(Failed(place, session, index, number, failure, what, reason_of(score, report)))
    return found


def stopped(trials: Sequence[Trial]) -> list[int]:
    """Return the indices of trials whose script did not finish."""
    return [place for place, trial in enumerate(trials) if not trial.finished]


def picked(failed: Sequence[Failed], most: int) -> list[Failed]:
    """Pick at most this many, in turn from each kind of failure; return them in order of trial and goal."""
    by_name = groupby(sorted(failed, key=lambda one: one.failure), key=lambda one: one.failure)
    in_turn = chain.from_iterable(zip_longest(*(list(group) for _, group in by_name)))
    chosen = [one for one in in_turn if one is not None][:most]
    return sorted(chosen, key=lambda one: (one.place, one.number))


Moments = Mapping[tuple[int, int | None], tuple[str, float]]
"""Address that plays each failure, empty if there is none, and its time in s; by the index of its trial and the number
of its goal, or None: where the trial's script stopped."""


def moments_of(
    noted: Sequence[Trial],
    failed: Sequence[Failed],
    report: TaskReport,
    read: Callable[[int], Trial],
    address: Callable[[int, int | None, float], str],
) -> Moments:
    """Return the moments of all failures.

    Args:
        noted: the trials of the run, without their arrays.
        failed: their goals that were not reached.
        report: of their task.
        read: returns the trial of an index, from which the time is found; those of one trial are asked for in a row.
        address: returns the address for a trial's index, a goal's number or None, and the time in s.
    """
    found = {}
    keys = [*((place, None) for place in stopped(noted)), *((one.place, one.number) for one in failed)]
    for place, number in sorted(keys, key=lambda key: key[0]):
        trial = read(place)
        at_s = trial.duration_s if number is None else report.failed_s(trial, trial.scores[number])
        found[place, number] = address(place, number, at_s), at_s
    return found


def failures_list(trials: Sequence[Trial], failed: Sequence[Failed], moments: Moments) -> str:
    """Return a row for each trial whose script stopped and each goal that was not reached, as HTML; empty if none."""
    rows = []
    for place in stopped(trials):
        trial = trials[place]
        rows.append(_row("the whole trial", trial.ended, trial.reason, trial, moments[place, None]))
    for one in picked(failed, MOST):
        failure = one.failure or "not done"
        rows.append(_row(one.what, failure, one.reason, trials[one.place], moments[one.place, one.number]))
    if not rows:
        return ""
    columns = (Column("what"), Column("failure"), Column("why"), Column("where"), Column("at s", number=True))
    left = len(failed) - MOST
    hint = "A click plays the trial from shortly before the moment of the failure."
    more = f"{counted(left, 'more failure')}: in the trials below."
    return (
        (paragraph(hint, "quiet") if any(address for address, _ in moments.values()) else "")
        + listing(columns, rows)
        + (paragraph(more, "quiet") if left > 0 else "")
    )


def _row(what: str, failure: str, why: str, trial: Trial, moment: tuple[str, float]) -> list[str]:
    address, at_s = moment
    first = link(address, what) if address else escape(what)
    return [first, flagged(in_words(failure)), escape(why), place_of(trial), f"{at_s:.1f}"]


def flagged(text: str) -> str:
    """Return what went wrong, marked as such, in HTML; empty if nothing did."""
    return f"<span class=bad>{escape(text)}</span>" if text else ""
