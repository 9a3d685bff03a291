"""The folder of a run: which trials are done, which are still to do, and whether it belongs to this run at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from trocar.counting import counted
from trocar.errors import BadFile, TrocarError
from trocar.eval.config import MAX_TRIALS, RunConfig
from trocar.eval.method import CLIENT
from trocar.eval.trial import Trial, trial_about, trial_file, trial_files
from trocar.eval.trials import Trials
from trocar.files.output import write_json
from trocar.files.reading import read_json
from trocar.lab import require_reach

RECORD = "run.json"
MAX_SHOWN = 4
"""Maximum number of runs' folders that an error message suggests."""


def open_folder(config: RunConfig, folder: str | Path) -> list[tuple[int, int]]:
    """Make a run's folder, or resume an interrupted run; return (session, trial) of the trials still to do.

    A trial that cannot be read counts as not done: the same command runs it again.

    Raises:
        BadFile: the folder holds another run, a trial of another run, or cannot be written.
    """
    folder = Path(folder)
    record, about, fingerprint = folder / RECORD, config.about(), config.fingerprint
    if folder.is_file():
        raise BadFile(folder, "is a file", "choose a folder with --out")
    require_reach(config.laboratory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if record.is_file():
            found = run_record(folder)
            if not found:
                problem = "is damaged, so it is unknown whose trials lie beside it"
                remedy = "choose another folder with --out, or move it away if they are of this run"
                raise BadFile(record, problem, remedy)
            if any(folder.glob("session_*")):  # otherwise there is nothing yet that could be mixed up
                _require_same(found, about, folder)
        text = {**about, "fingerprint": fingerprint, "sessions": config.sessions, "trials": config.trials}
    except OSError as error:
        raise BadFile(folder, f"cannot be used ({error})", "choose another with --out", kind="folder") from None
    write_json(record, text, "run")
    wanted = [(session, index) for session in range(config.sessions) for index in range(config.trials)]
    return [place for place in wanted if not is_done(folder, place, fingerprint)]


def load_trials(folder: str | Path) -> tuple[Trials, list[str]]:
    """Return the finished trials of a run's folder in order, and a sentence for each that cannot be used.

    Every file is read once for a check; the returned sequence reads a trial again on request. ``run.json`` tells which
    run the folder belongs to, or, if it is lost, the first trial.

    Raises:
        BadFile: there is no such folder, or no trial in it.
    """
    folder = Path(folder)
    if folder.is_file():
        raise BadFile(folder, "is a file", "give the folder of a run")
    if not folder.is_dir():
        raise BadFile(folder, "does not exist", "make one with `trocar run`", kind="folder")
    usable: list[Path] = []
    strange: list[str] = []
    for path, found in look_through(folder, Trial.load):
        if isinstance(found, str):
            strange.append(found)
        else:
            usable.append(path)
    if not usable:
        more = f" ({strange[0]})" if strange else ""
        raise BadFile(folder, f"holds no trial that can be read{more}", where_runs_are(folder), kind="folder")
    return Trials(usable), strange


def look_through(folder: str | Path, read: Callable[..., Trial]) -> Iterator[tuple[Path, Trial | str]]:
    """Yield each trial's file in a run's folder, in order, with its trial, or a sentence if it cannot be used.

    ``read`` returns the trial in a file: ``Trial.load`` or ``Trial.load_noted``.
    """
    run = str(run_record(folder).get("fingerprint", ""))
    for path in trial_files(folder):
        try:
            trial = read(path)
        except TrocarError as error:
            yield path, f"left aside: {error}"
            continue
        run = run or trial.about["fingerprint"]
        if trial.about["fingerprint"] != run:
            yield path, f"left aside: {str(path)!r} is of another run"
        elif trial_file(folder, *_place(trial.about)) != path:
            session, index = _place(trial.about)
            yield path, f"left aside: {str(path)!r} is session {session}, trial {index} under another name"
        else:
            yield path, trial


def where_runs_are(folder: str | Path) -> str:
    """Return advice for a folder that is not a run's: which folders of runs lie in or around it, or how to make one."""
    folder = Path(folder).absolute()
    found = [place for place in folder.parents if (place / RECORD).is_file()][:1]
    found = found or sorted(path.parent for path in folder.glob(f"*/{RECORD}"))
    if not found:
        return "make some with `trocar run`"
    more = " ..." if len(found) > MAX_SHOWN else ""
    return f"give the folder of a run: {', '.join(str(path) for path in found[:MAX_SHOWN])}{more}"


def load_trial(path: str | Path) -> Trial:
    """Return the trial in a file; in the folder of a run, only if it belongs to that run.

    Raises:
        BadFile: the file does not exist, is not a trial, or is not the trial that its path indicates.
    """
    path = Path(path)
    trial = Trial.load(path)
    folder = path.absolute().parent.parent
    run = str(run_record(folder).get("fingerprint", ""))
    if run and trial.about["fingerprint"] != run:
        raise BadFile(path, "belongs to another run than its folder", "give one of that run")
    if run and trial_file(folder, *_place(trial.about)) != path.absolute():
        session, index = _place(trial.about)
        raise BadFile(path, f"is session {session}, trial {index} under another name", "give it its own name")
    return trial


def requested(folder: str | Path) -> tuple[int, int] | None:
    """Return the requested numbers of sessions and of trials in each; None if its record is lost or impossible."""
    found = run_record(folder)
    try:
        sessions, trials = int(found["sessions"]), int(found["trials"])
    except (ValueError, KeyError, TypeError, OverflowError):
        return None
    return (sessions, trials) if min(sessions, trials) > 0 and sessions * trials <= MAX_TRIALS else None


def still_to_do(folder: str | Path, done: int) -> list[str]:
    """Return a sentence if a run has fewer trials than requested, so that nobody takes it for the whole run."""
    if run_record(folder).get("method") == CLIENT:
        return []  # an outside program asks for its trials one by one
    record = requested(folder)
    if record is None:
        return [f"{str(Path(folder) / RECORD)!r} cannot be read, so the run's number of trials is unknown"]
    sessions, trials = record
    if done >= sessions * trials:
        return []
    wanted = counted(sessions * trials, "trial")
    return [f"{done} of the run's {wanted} exist; the command that started it does the rest"]


def _place(about: dict[str, Any]) -> tuple[int, int]:
    return about["session"], about["index"]


def run_record(folder: str | Path) -> dict[str, Any]:
    """Return the record of the run that a folder was made for; empty if it is lost."""
    try:
        found = read_json(Path(folder) / RECORD)
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def is_done(folder: str | Path, place: tuple[int, int], fingerprint: str) -> bool:
    """Return whether a trial of this run exists and can be read (BadFile: it is of another run)."""
    path = trial_file(folder, *place)
    if not path.is_file():
        return False
    try:
        about = trial_about(path)
    except TrocarError:
        return False
    if about["fingerprint"] != fingerprint:
        raise BadFile(path, "is a trial of another run", "move it away, or choose another folder with --out")
    try:  # the whole file, not only its header
        return _place(about) == place and bool(Trial.load(path))
    except TrocarError:
        return False


def set_aside(path: str | Path) -> None:
    """Rename a file in the place of a trial that is still to be run, so that nothing is lost."""
    path = Path(path)
    if path.is_file():
        path.replace(path.with_name(f"{path.name}.aside"))


def _require_same(found: dict[str, Any], about: dict[str, Any], folder: Path) -> None:
    other = [_difference(key, found.get(key), value) for key, value in about.items() if found.get(key) != value]
    if other:
        raise BadFile(folder, f"holds another run ({', '.join(other)})", "choose another folder with --out")


def _difference(key: str, found: object, wanted: object) -> str:
    """Return a description of a folder's value of a differing key, short enough for an error message."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        other = [_difference(k, found.get(k), value) for k, value in wanted.items() if found.get(k) != value]
        return ", ".join(other) or f"other {key}"
    text = f"{key} {found!r}"
    return text if len(text) <= 60 else f"other {key}"
