"""The runs below some folders, from their trials' headers; unchanged files are not read again."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trocar.counting import Tick, untold
from trocar.errors import BadFile, InvalidInput, TrocarError
from trocar.eval.folder import RECORD, look_through, run_record, still_to_do
from trocar.eval.trial import ABOUT, Trial, trial_file, trial_files
from trocar.report.summary import summarise

KEYS = ("sessions", "trials", "goal_noun", "attempted", "succeeded", "success_rate", "success_ci95", "mean_time_s")
KEYS += ("collisions_per_trial", "completion_time_s", "complete_trials")
"""Keys of a run's summary that its row contains."""

BEGUN = "no trial is finished yet; the command that started the run does the rest"


@dataclass(frozen=True)
class Run:
    """A run as it was found.

    Attributes:
        name: its folder, relative to the folder that all runs have in common.
        folder: absolute.
        about: what distinguishes it from other runs, from its first trial or else its record; any key may be missing.
        trials: the usable ones, in order, without arrays, spans and events.
        remarks: sentences on what is missing or cannot be used.
        figures: of ``KEYS``, as in ``summary.json``; empty without a trial.
    """

    name: str
    folder: Path
    about: Mapping[str, Any]
    trials: Sequence[Trial] = ()
    remarks: Sequence[str] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def difficulty(self) -> str:
        """Return how hard its laboratory was; empty for real arms, or if unknown."""
        return ", ".join(map(str, self.about.get("difficulty") or ()))

    @property
    def version(self) -> str:
        """Return the version of Trocar that made it; empty if unknown."""
        return str((self.about.get("versions") or {}).get("trocar", ""))

    def row(self) -> dict[str, Any]:
        """Return its row of the table as JSON values; what is unknown is None."""
        known = {key: self.about.get(key) for key in ("task", "variant", "method", "model", "station", "seed")}
        return {
            "name": self.name,
            "folder": str(self.folder),
            **known,
            "difficulty": self.difficulty or None,
            **{key: self.figures.get(key) for key in KEYS},
            "version": self.version or None,
            "remarks": list(self.remarks),
        }

    def trial(self, session: int, index: int) -> Path:
        """Return the file of one of its trials.

        Raises:
            InvalidInput: it is none of the usable ones.
        """
        if not any((trial.about["session"], trial.about["index"]) == (session, index) for trial in self.trials):
            raise InvalidInput(f"run {self.name}", f"has no trial {index} of session {session}", "choose another")
        return trial_file(self.folder, session, index)


class Shelf:
    """Finds and reads the runs below some folders.

    Args:
        folders: to be searched; a run's own folder will do too.

    Raises:
        BadFile: there is no such folder.
    """

    def __init__(self, folders: Sequence[str | Path]):
        self.folders = tuple(dict.fromkeys(Path(folder).absolute() for folder in folders))
        for folder in self.folders:
            if not folder.is_dir():
                problem = "is a file" if folder.exists() else "does not exist"
                raise BadFile(folder, problem, "give a folder that holds runs", kind="folder")
        self._lock = threading.Lock()
        self._read: dict[Path, tuple[tuple[int, int], Trial | TrocarError]] = {}
        self._made: dict[Path, tuple[object, Run]] = {}

    def runs(self, tick: Tick = untold) -> list[Run]:
        """Return all runs as they are now, sorted by folder; read only trials that are new or have changed."""
        with self._lock:
            folders = sorted({found for folder in self.folders for found in _runs_below(folder)})
            total, done = sum(len(trial_files(folder)) for folder in folders), 0

            def read(path: Path) -> Trial:
                nonlocal done
                tick("reading trials", done, total)
                done += 1
                return self._trial(path)

            common = Path(os.path.commonpath(self.folders))
            runs = []
            for folder in folders:
                name = folder.name if folder == common else str(folder.relative_to(common))
                found = list(look_through(folder, read))
                trials = [trial for _, trial in found if isinstance(trial, Trial)]
                strange = [said for _, said in found if isinstance(said, str)]
                runs.append(self._run(name, folder, trials, strange))
            there = set(folders)
            self._read = {path: kept for path, kept in self._read.items() if path.parent.parent in there}
            self._made = {folder: kept for folder, kept in self._made.items() if folder in there}
            return runs

    def _trial(self, path: Path) -> Trial:
        """Return a trial without what no table needs; for an unchanged bad file, raise the same error again."""
        stamp = _stamp(path)
        kept = self._read.get(path)
        if kept is None or kept[0] != stamp:
            try:
                found: Trial | TrocarError = replace(Trial.load_noted(path), spans=[], events=[], computations=[])
            except TrocarError as error:
                found = error
            kept = self._read[path] = (stamp, found)
        if isinstance(kept[1], TrocarError):
            raise kept[1]
        return kept[1]

    def _run(self, name: str, folder: Path, trials: list[Trial], strange: list[str]) -> Run:
        """Return a run; for the same trials, its figures are not computed again."""
        key = (_stamp(folder / RECORD), [id(trial) for trial in trials], strange)
        if folder not in self._made or self._made[folder][0] != key:
            self._made[folder] = key, _made(name, folder, trials, strange)
        return self._made[folder][1]


def named(runs: Sequence[Run], name: str) -> Run:
    """Return the run of this name.

    Raises:
        InvalidInput: there is none.
    """
    found = next((run for run in runs if run.name == name), None)
    if found is None:
        raise InvalidInput(f"run {name!r}", "is not here (any more)", "choose another from the table")
    return found


def _made(name: str, folder: Path, trials: list[Trial], strange: list[str]) -> Run:
    """Return a run of these trials; whatever is wrong with it is a remark."""
    if not trials:
        record = run_record(folder)  # other programs write files of this name too
        about = {key: record[key] for key, kind in ABOUT.items() if isinstance(record.get(key, ...), kind)}
        if "task" not in about:
            said = "is not the record of a run" if record else "cannot be read"
            strange = [*strange, f"{RECORD} {said}, and no trial beside it"]
        return Run(name, folder, about, remarks=strange or [BEGUN])
    try:
        summary = summarise(trials)
    except (KeyError, TypeError, ValueError) as error:  # from headers, whose values nothing else checks
        return Run(name, folder, trials[0].about, remarks=[*strange, f"its trials cannot be summed up ({error})"])
    figures = {key: summary[key] for key in KEYS}
    return Run(name, folder, trials[0].about, trials, [*strange, *still_to_do(folder, len(trials))], figures)


def _runs_below(folder: Path) -> Iterator[Path]:
    """Yield the runs' folders in and below a folder: those with a record or trials. Skip their sessions' folders."""
    for place, inside, files in os.walk(folder):
        sessions = [name for name in inside if name.startswith("session_")]
        if RECORD in files or (sessions and trial_files(place)):
            yield Path(place)
            inside[:] = [name for name in inside if name not in sessions]
        inside[:] = sorted(name for name in inside if not name.startswith("."))


def _stamp(path: Path) -> tuple[int, int]:
    """Return a file's time of modification and size; zeros if it does not exist."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size
