"""Running a measurement's command and keeping what the docs need of its output.

If a measurement consists of trials, its first sessions are run again first. If they are the same to the last bit, the
changes of the code do not affect the figures, and these are carried over. The last bits also depend on the machine, so
on another one than the record's, the sessions are run with the code of the record, too.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from declared_figures import Measurement, Record
from source_age import commit_of, digest_of, unpack
from trocar.errors import TrocarError
from trocar.eval.trial import FORMAT, VERSION
from trocar.files.archive import read_archive

FIRST = 2
"""Number of first sessions whose trials are compared."""

SESSIONS = re.compile(r"--sessions (\d+)")

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that keep the libraries of a process to one core."""


def measure(root: Path, measurement: Measurement, jobs: int, before: Record | None = None) -> Record:
    """Run a measurement's command, and return its record.

    Files kept between runs are in a folder for these sources, so that results of other code are not mixed in.

    Args:
        root: root of the repository.
        measurement: what to measure.
        jobs: number of processes of the command.
        before: record of older code, carried over if the first sessions are the same.

    Raises:
        TrocarError: the sources are not committed, the command fails, or its output lacks something.
    """
    digest, commit = digest_of(root, measurement.sources), commit_of(root, measurement.sources)
    folder = Path("out/figures") / f"{measurement.name}-{digest[:8]}"
    words = measurement.run_with.format(folder=folder, jobs=jobs)

    def run(command: str) -> str:
        answer = _run(root, f"{command} {words}")
        if digest_of(root, measurement.sources) != digest:
            raise TrocarError(f"the sources of {measurement.name} have changed while it was measured; measure it again")
        return answer

    record = None
    if before and before.trials and before.digest != digest and before.command == measurement.command:
        first = SESSIONS.sub(f"--sessions {FIRST}", measurement.command)
        run(first)
        trials = first_trials(root / folder)
        if trials == before.trials or trials == trials_then(root, measurement, before, f"{first} {words}", folder):
            record = replace(before, digest=digest, same_at=commit, older=False, trials=trials)
    if record is None:
        values = read_answer(measurement, run(measurement.command))
        today = datetime.datetime.now(datetime.UTC).date().isoformat()
        record = Record(measurement.command, commit, values, today, digest, trials=first_trials(root / folder))
    return record


def trials_then(root: Path, measurement: Measurement, before: Record, line: str, folder: Path) -> dict[str, str] | None:
    """Return the digests of the first trials that the code of a record makes on this machine.

    Returns None if git does not have that code.

    Raises:
        TrocarError: the command ends with an error.
    """
    code = root / "out" / "figures" / f"code-of-{measurement.name}-{before.digest[:8]}"
    if not unpack(root, before.same_at or before.commit, code):
        return None
    found = None
    if digest_of(code, measurement.sources) == before.digest:
        _run(code, line)
        found = first_trials(code / folder)
    shutil.rmtree(code)
    return found


def first_trials(folder: Path) -> dict[str, str]:
    """Return digests of the trials of the first sessions below a folder, by path, without the run's settings."""
    found = {}
    for number in range(FIRST):
        for path in sorted(folder.glob(f"**/session_{number:02d}/trial_*.npz")):
            archive = read_archive(path, FORMAT, VERSION)
            header = {key: value for key, value in archive.header.items() if key != "about"}
            whole = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
            for name, array in sorted(archive.arrays.items()):
                whole.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
            found[path.relative_to(folder).as_posix()] = whole.hexdigest()[:16]
    return dict(sorted(found.items()))


def read_answer(measurement: Measurement, answer: str) -> dict[str, Any]:
    """Return what is kept of a command's output.

    Raises:
        TrocarError: something is not in it.
    """
    found: dict[str, Any] = {}
    if measurement.keep:
        try:
            whole = json.loads(answer)
        except ValueError:
            raise TrocarError(f"{measurement.name}: the command printed no JSON: {answer[:80]!r}") from None
        for place, key in measurement.index.items():
            whole[place] = {each[key]: each for each in whole[place]}
        for path in measurement.keep:
            found = _joined(found, _picked(whole, path.split("."), f"{measurement.name}: {path}"))
    for name, pattern in measurement.find.items():
        matches = [match.groups() for match in re.finditer(pattern, answer, re.MULTILINE)]
        if not matches:
            raise TrocarError(f"{measurement.name}: {name} is not in what the command printed; mend its pattern")
        values = [_number(group) for groups in matches for group in groups]
        found[name] = values[0] if len(values) == 1 else values
    return found


def _run(root: Path, line: str) -> str:
    words = shlex.split(line)
    starts = {"trocar": [sys.executable, "-m", "trocar"], "python": [sys.executable]}
    if words[0] not in starts:
        raise TrocarError(f"command {line!r} must begin with one of {', '.join(starts)}")
    paths = os.pathsep.join(filter(None, [str(root / "src"), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [*starts[words[0]], *words[1:]],
        cwd=root,
        env={**os.environ, "PYTHONPATH": paths} | dict.fromkeys(ONE_THREAD, "1"),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TrocarError(f"{line!r} ended with exit code {done.returncode}; what it said stands above")
    return done.stdout


def _picked(value: Any, steps: Sequence[str], said: str) -> Any:
    """Return the part of a nested value that lies on a path."""
    if not steps:
        return value
    if not isinstance(value, dict) or (steps[0] != "*" and steps[0] not in value):
        raise TrocarError(f"{said}: there is no {steps[0]!r} in what the command printed")
    names = list(value) if steps[0] == "*" else [steps[0]]
    return {name: _picked(value[name], steps[1:], said) for name in names}


def _joined(one: Any, other: Any) -> Any:
    if not (isinstance(one, Mapping) and isinstance(other, Mapping)):
        return other
    return {**one, **{key: _joined(one[key], value) if key in one else value for key, value in other.items()}}


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
