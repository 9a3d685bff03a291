"""Trials of a run: read one at a time, as a table, and compared with those of another run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, overload

from trocar.counting import counted
from trocar.errors import BadFile, InvalidInput
from trocar.eval.comparison import Difference, session_difference
from trocar.eval.statistics import by_session
from trocar.eval.trial import Trial


@dataclass(frozen=True)
class Comparison:
    """One run minus another, over the sessions that both have.

    Attributes:
        success_rate: share of goals reached; p tests for a higher one.
        time_s: duration of a trial divided by its number of goals; p tests for a shorter one.
        collisions: collisions per trial; p tests for fewer.
    """

    success_rate: Difference
    time_s: Difference
    collisions: Difference

    def __repr__(self) -> str:
        found = ", ".join(f"{field.name} {getattr(self, field.name).mean:+.3g}" for field in fields(self))
        return f"<Comparison over {counted(self.success_rate.sessions, 'session')}: {found}>"


class Trials(Sequence[Trial]):
    """Trials in files, each read on request; at most one is held in memory.

    Args:
        paths: the files, in order.
    """

    def __init__(self, paths: Sequence[str | Path]):
        self.paths = tuple(map(Path, paths))
        self._last: tuple[Path, Trial] | None = None

    def __repr__(self) -> str:
        if not self.paths:
            return "<no trials>"
        first, sessions = self.notes[0], {trial.about["session"] for trial in self.notes}
        done, goals = (
            sum(sum(bool(s[key]) for s in t.scores) for t in self.notes) for key in ("succeeded", "attempted")
        )
        what = " ".join(str(first.about[key]) for key in ("task", "variant", "method") if first.about[key])
        how_many = f"{counted(len(self), 'trial')} of {what} in {counted(len(sessions), 'session')}"
        return f"<{how_many}: {done} of {counted(goals, first.goal_noun)}>"

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, place: int) -> Trial: ...
    @overload
    def __getitem__(self, place: slice) -> Trials: ...
    def __getitem__(self, place: int | slice) -> Trial | Trials:
        """Return a trial, or some of them."""
        if isinstance(place, slice):
            return Trials(self.paths[place])
        path = self.paths[place]
        if self._last is None or self._last[0] != path:
            self._last = None  # frees the memory before the next one is read
            self._last = path, Trial.load(path)
        return self._last[1]

    @cached_property
    def notes(self) -> list[Trial]:
        """Return each trial as :meth:`Trial.noted` would; arrays and images are not read."""
        return list(map(Trial.load_noted, self.paths))

    def only(self, path: str | Path) -> Trials:
        """Return a sequence of the trial in this file alone.

        Raises:
            BadFile: the file cannot be used, or is of another run.
        """
        path = Path(path)
        if path not in self.paths:
            Trial.load(path)  # raises an error that says what is wrong with it
            raise BadFile(path, "is not a trial of this run", "choose another with --session and --trial")
        return Trials((path,))

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each goal of each trial: task, variant, method, seed, session, trial, goal and score."""
        return [
            {
                **{key: trial.about[key] for key in ("task", "variant", "method", "seed", "session")},
                "trial": trial.about["index"],
                "goal": number,
                **score,
            }
            for trial in self.notes
            for number, score in enumerate(trial.scores)
        ]

    def to_frame(self) -> Any:
        """Return :meth:`rows` as a ``pandas.DataFrame``.

        Raises:
            InvalidInput: pandas, which is not a dependency, is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ImportError:
            remedy = "pip install pandas, or use .rows() or `trocar export`"
            raise InvalidInput("to_frame()", "needs pandas, which is not installed", remedy) from None
        return pandas.DataFrame(self.rows())

    def compare(self, other: Trials) -> Comparison:
        """Return these trials minus others in the same sessions, with intervals over sessions.

        Raises:
            InvalidInput: there are no trials, or they are from other sessions.
        """
        return compared(self.notes, other.notes)


def sessions_met(trials: Sequence[Trial]) -> set[tuple[str, ...]]:
    """Return what the trials' sessions are drawn from; if it is equal, sessions of the same number are the same."""
    keys = ("task", "station_digest", "seed", "difficulty")
    return {tuple(map(str, map(trial.about.get, keys))) for trial in trials}


def noted(trials: Sequence[Trial]) -> list[Trial]:
    """Return :meth:`Trial.noted` of each of these trials."""
    return trials.notes if isinstance(trials, Trials) else [trial.noted() for trial in trials]


def compared(ours: Sequence[Trial], theirs: Sequence[Trial]) -> Comparison:
    """Return trials minus others in the same sessions, with intervals over sessions.

    Raises:
        InvalidInput: there are no trials, or they are from other sessions.
    """
    where = [sessions_met(trials) for trials in (ours, theirs)]
    if where[0] != where[1] or len(where[0]) != 1:
        problem = "did not meet the same sessions"
        raise InvalidInput("these trials", problem, "give both runs the same task, station, difficulty and seed")

    def difference(value: Callable[[Trial], float], *, less: bool) -> Difference:
        return session_difference(by_session(ours, value), by_session(theirs, value), less=less)

    return Comparison(
        success_rate=difference(lambda t: sum(bool(s["succeeded"]) for s in t.scores) / len(t.scores), less=False),
        time_s=difference(lambda t: t.duration_s / len(t.scores), less=True),
        collisions=difference(lambda t: float(len(t.collisions)), less=True),
    )
