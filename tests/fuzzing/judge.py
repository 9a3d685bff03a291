"""What becomes of a bad input: refused in a sentence, done, or one of the things that may not be."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import sys
import traceback
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from fuzzing.lines import Case
from trocar.calibration.recording import Recording
from trocar.cli import main
from trocar.geometry import SE3, SO3

HANG_S = 10.0
"""Of the processor's time, not of the clock: other programs run too."""

WORK = (
    "trocar.eval.jobs.prepare",
    "trocar.eval.jobs.run_trial",
    "trocar.eval.workers.run_all",
    "trocar.eval.jobs.run_all",
    "trocar.collect.collection.Collection.run",
    "trocar.collect.checkerboard.register_cell",
    "trocar.calibration.models.lstm.LstmModel.fit",
    "trocar.calibration.fleet.fit_from_prior",
    "trocar.calibration.fleet.learn_prior",
    "trocar.calibration.study.run_models",
    "trocar.tasks.suture.planning.setup_map.setup_map",
    "trocar.tasks.suture.planning.setup_search.search_setup",
    "trocar.tasks.suture.view.PlanView",
    "trocar.view.trial_view.TrialView",
    "trocar.report.browse.BrowseServer",
    "trocar.report.files._pictures",
    "webbrowser.open",
)
"""Where long work begins: an input that comes so far was accepted, and the work is not done here."""

NOT_FINITE = re.compile(r"(?<![\w./\\-])[-+]?(nan|inf|infinity)(?!\w)", re.IGNORECASE)

DONE, ACCEPTED, REFUSED, FAILED, USAGE = "done", "accepted", "refused", "task failed", "usage"
TRACEBACK, HANG, SILENT, LOST, UNSPOKEN = "traceback", "hang", "not finite", "file lost", "no sentence"
WRONG = (TRACEBACK, HANG, SILENT, LOST, UNSPOKEN)


class Began(BaseException):
    """Long work was asked for."""


class Hung(BaseException):
    """It took too long."""


@dataclass(frozen=True)
class Verdict:
    """What became of an input.

    Attributes:
        kind: in a word.
        code: exit code of a command, None of anything else.
        told: the last lines that it printed, or the error.
    """

    kind: str
    code: int | None
    told: str = ""


@contextmanager
def limited(seconds: float = HANG_S) -> Iterator[None]:
    """Raise ``Hung`` where a block takes more of the processor's time."""

    def stop(*_: object) -> None:
        raise Hung

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@contextmanager
def without_work() -> Iterator[None]:
    """Let long work begin, and no more."""

    def began(*_: object, **__: object) -> Any:
        raise Began

    with ExitStack() as stack:
        for name in WORK:
            stack.enter_context(patch(name, began))
        yield


def judged(case: Case, folder: Path) -> Verdict:
    """Run a line in the folder of good files, and leave the folder as it was."""
    before = _state(folder)
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=case.encoding, errors=how) for how in HOW)
    code, raised = 0, ""
    was = Path.cwd()
    os.chdir(folder)
    try:
        with (
            patch.object(sys, "argv", ["trocar", *case.words]),
            patch.dict(os.environ, {"COLUMNS": case.columns}),
            without_work(),
            redirect_stdout(out),
            redirect_stderr(err),
            limited(),
        ):
            main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except Began:
        code = -1
    except Hung:
        code, raised = -2, HANG
    except BaseException:
        raised = traceback.format_exc()
    finally:
        os.chdir(was)
    verdict = _verdict(case, code, raised, _text(out), _text(err), folder, before)
    _restore(folder, before)
    return verdict


HOW = ("strict", "backslashreplace")
"""How Python's stdout and stderr treat what they cannot encode."""


def _text(stream: io.TextIOWrapper) -> str:
    with suppress(ValueError):
        stream.flush()
    return stream.buffer.getvalue().decode(errors="replace")  # type: ignore[attr-defined]


def _verdict(
    case: Case, code: int, raised: str, out: str, err: str, folder: Path, before: dict[Path, tuple[int, int]]
) -> Verdict:
    last = (raised or err or out)[-2000:]
    if raised == HANG:
        return Verdict(HANG, None, "")
    if raised or code == 70 or "Traceback (most recent call last)" in err:
        return Verdict(TRACEBACK, code, last)
    if lost := [path for path, was in before.items() if not path.exists() or _stamp(path) != was]:
        return Verdict(LOST, code, f"{lost[0]}")
    if code in (0, 1) and (found := _not_finite(case, out, folder, before)):
        return Verdict(SILENT, code, found)
    if code in (2, 3):
        usage = err.startswith("Usage: ")
        sentence = re.fullmatch(r"trocar: [^\n]+\n", err.rsplit("\r", 1)[-1].lstrip("\x1b[0123456789KJm"))
        return Verdict(USAGE if usage else REFUSED if sentence else UNSPOKEN, code, last)
    return Verdict({-1: ACCEPTED, 0: DONE, 1: FAILED}.get(code, TRACEBACK), code, last)


def _not_finite(case: Case, out: str, folder: Path, before: dict[Path, tuple[int, int]]) -> str:
    """Return where a number that is not finite was printed or written; empty if nowhere."""
    for word in sorted(case.words, key=len, reverse=True):
        out = out.replace(word, "") if word else out
    if found := NOT_FINITE.search(out):
        return f"stdout: {out[max(0, found.start() - 150) : found.end() + 50]}"
    for path in folder.rglob("*"):
        if path.is_file() and path not in before and "bad" not in path.relative_to(folder).parts[:1]:
            if path.suffix in (".csv", ".json", ".toml") and NOT_FINITE.search(path.read_text(errors="replace")):
                return str(path)
            if path.suffix == ".npz" and _holds_not_finite(path):
                return str(path)
    return ""


def _holds_not_finite(path: Path) -> bool:
    try:
        with np.load(path) as arrays:
            values = [arrays[name] for name in arrays.files if name != "header.json" and not name.endswith("scale")]
    except (ValueError, zipfile.BadZipFile):
        return False
    return any(value.dtype.kind == "f" and not np.isfinite(value).all() for value in values)


def _state(folder: Path) -> dict[Path, tuple[int, int]]:
    bad = folder / "bad"
    return {p: _stamp(p) for p in folder.rglob("*") if p.is_file() and bad not in p.parents}


def _stamp(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size


def _restore(folder: Path, before: dict[Path, tuple[int, int]]) -> None:
    """Remove what a line wrote."""
    for path in list(folder.rglob("*")):
        if path.is_file() and path not in before:
            path.unlink()
    shutil.rmtree(folder / "bad", ignore_errors=True)
    kept = {parent for path in before for parent in path.parents}
    for path in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
        if path not in kept and path.name != "folder":
            with suppress(OSError):
                path.rmdir()


def judged_call(make: Callable[[], Any]) -> Verdict:
    """Call a constructor or a function, and judge what it returns or raises."""
    try:
        with limited():
            made = make()
    except Hung:
        return Verdict(HANG, None)
    except (ValueError, TypeError, KeyError) as error:
        return Verdict(REFUSED, None, f"{type(error).__name__}: {error}"[:300])
    except Exception:
        return Verdict(TRACEBACK, None, traceback.format_exc()[-1500:])
    return Verdict(SILENT, None, str(make)[:300]) if _holds_nan(made) else Verdict(DONE, None)


def _holds_nan(made: Any) -> bool:
    """Return whether NaN went into a value, or came out of a function, without a word."""
    if isinstance(made, Recording | SE3 | SO3):
        return False  # of rows that are not valid; poses of a batch that are not known
    if isinstance(made, float | np.ndarray):
        return bool(np.isnan(made).any()) if np.asarray(made).dtype.kind == "f" else False
    if is_dataclass(made) and not isinstance(made, type):
        return any(_holds_nan(getattr(made, field.name)) for field in fields(made))
    if isinstance(made, Mapping):
        return any(map(_holds_nan, made.values()))
    return isinstance(made, list | tuple) and any(map(_holds_nan, made))
