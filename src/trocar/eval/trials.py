"""Trials of a run, read one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import overload

from trocar.counting import counted
from trocar.errors import BadFile
from trocar.eval.trial import Trial


class Trials(Sequence[Trial]):
    """Trials in files, each read on request: at most one is held in memory, however many there are.

    Args:
        paths: of the files, in order.
    """

    def __init__(self, paths: Sequence[str | Path]):
        self.paths = tuple(map(Path, paths))
        self._last: tuple[Path, Trial] | None = None

    def __repr__(self) -> str:
        if not self.paths:
            return "<no trials>"
        first, sessions = self._notes[0], {trial.about["session"] for trial in self._notes}
        done, goals = (
            sum(sum(bool(s[key]) for s in t.scores) for t in self._notes) for key in ("succeeded", "attempted")
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
            self._last = None  # before the next one is read
            self._last = path, Trial.load(path)
        return self._last[1]

    @cached_property
    def _notes(self) -> list[Trial]:
        return [trial.noted() for trial in self]

    def only(self, path: str | Path) -> Trials:
        """Return one of the trials alone.

        Raises:
            BadFile: its file cannot be used, or is of another run.
        """
        path = Path(path)
        if path not in self.paths:
            Trial.load(path)  # raises an error that says what is wrong with it
            raise BadFile(path, "is not a trial of this run", "choose another with --session and --trial")
        return Trials((path,))
