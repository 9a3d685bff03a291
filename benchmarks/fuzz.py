"""Give bad inputs to every command and public constructor, and count the outcomes.

    python benchmarks/fuzz.py --examples 10000 --jobs 2

Command lines are drawn for all commands: options of every type with odd numbers and words, files that are truncated,
altered, swapped or claim to be huge. Long work is skipped: an input that would begin it counts as accepted. Each batch
runs in a process of its own, so that one that hangs can be stopped. Each kind of forbidden outcome is printed once;
tracebacks go to ``--log``. `tests/fuzz` tries a few of the same inputs.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import select
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from fuzzing import judge
from fuzzing.constructors import CONSTRUCTORS, calls
from fuzzing.files import good_files, make_good
from fuzzing.lines import cases
from hypothesis import HealthCheck, Phase, given, seed, settings

from synthetic import synthetic_trial

BATCH = 100
STUCK_S = 300.0
"""A batch that was silent this long is stuck where no signal reaches it."""
MEMORY_BYTES = 6 << 30
CALLS_EVERY = 5
"""Of this many batches, one calls constructors and functions, and the others try command lines."""


SETTINGS = partial(
    settings, phases=[Phase.generate], database=None, deadline=None, suppress_health_check=list(HealthCheck)
)


def lines_batch(number: int, count: int, write: Any, good: Path) -> None:
    """Judge a batch of command lines; write each input and its verdict, one JSON a line."""
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home) / "a" / "b"
        shutil.copytree(good, folder)
        good_files(folder)

        @seed(number)
        @SETTINGS(max_examples=count)
        @given(case=cases(folder))
        def each(case: Any) -> None:
            write({"tried": shlex.join(case.words), "columns": case.columns, "encoding": case.encoding})
            write(vars(judge.judged(case, folder)))

        each()


def calls_batch(number: int, count: int, write: Any) -> None:
    """Judge a batch of calls of public constructors."""

    @seed(number)
    @SETTINGS(max_examples=count)
    @given(call=calls())
    def each(call: Any) -> None:
        write({"tried": str(call)})
        write(vars(judge.judged_call(call)))

    each()


def forked(kind: str, number: int, count: int, good: Path) -> tuple[int, int]:
    """Begin a batch in a process of its own; return its process id and the end of its pipe to read."""
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        return child, reader
    os.close(reader)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)

    def write(values: dict[str, Any]) -> None:
        os.write(writer, json.dumps(values).encode() + b"\n")

    try:
        if kind == "lines":
            lines_batch(number, count, write, good)
        else:
            calls_batch(number, count, write)
    except BaseException as error:
        write({"broke": repr(error)[:500]})
    finally:
        os._exit(0)


class Batch:
    """A running batch.

    Args:
        kind: 'lines' or 'calls'.
        number: its seed.
        count: of examples.
        good: folder of good files.
    """

    def __init__(self, kind: str, number: int, count: int, good: Path):
        self.child, self.reader = forked(kind, number, count, good)
        self.kind, self.number, self.rest, self.tried, self.heard_s = kind, number, b"", {}, time.monotonic()

    def read(self) -> list[dict[str, Any]] | None:
        """Return the messages that have come since; None at the batch's end."""
        data = os.read(self.reader, 1 << 20)
        self.heard_s = time.monotonic()
        *lines, self.rest = (self.rest + data).split(b"\n")
        return [json.loads(line) for line in lines] if data else None

    def end(self) -> None:
        """Kill the batch's process."""
        os.kill(self.child, signal.SIGKILL)
        os.waitpid(self.child, 0)
        os.close(self.reader)


def where(told: str) -> str:
    """Return a traceback's last place in Trocar, and its error."""
    places = re.findall(r'File "[^"]*/trocar/([^"]+)", line (\d+)', told)
    errors = re.findall(r"^(\w+(?:\.\w+)*(?:Error|Exception|Warning|Interrupt)\b.*)$", told, re.MULTILINE)
    return f"{':'.join(places[-1]) if places else '?'} {errors[-1][:120] if errors else told[-120:]}"


class Tally:
    """Counts of the outcomes so far.

    Args:
        log: file for forbidden outcomes; None: no file.
    """

    def __init__(self, log: Path | None):
        self.counts, self.wrong = Counter[tuple[str, str]](), Counter[str]()
        self._log = log.open("w") if log else None

    def note(self, batch: Batch, verdict: dict[str, Any]) -> None:
        """Count a verdict; print the first forbidden one of each kind and place."""
        code = "" if verdict["code"] is None else f" ({verdict['code']})"
        self.counts[batch.kind, f"{verdict['kind']}{code}"] += 1
        if verdict["kind"] not in judge.WRONG:
            return
        place = where(verdict["told"]) if verdict["kind"] == judge.TRACEBACK else verdict["told"][-200:]
        place = f"{verdict['kind']}: {place or batch.tried.get('tried', '')[:60]}"
        if not self.wrong[place]:
            print(f"{batch.tried.get('tried', '')[:200]}\n    {place}", flush=True)
        self.wrong[place] += 1
        if self._log:
            self._log.write(json.dumps({"batch": batch.number, **batch.tried, **verdict}) + "\n")
            self._log.flush()

    def heard(self, batch: Batch, values: dict[str, Any]) -> None:
        """Handle a message of a batch: an input, its verdict, or why the batch broke."""
        if "tried" in values:
            batch.tried = values
        elif "broke" in values:
            print(f"batch {batch.number} broke: {values['broke']}", flush=True)
            batch.tried = {}
        else:
            self.note(batch, values)
            batch.tried = {}

    def ended(self, batch: Batch) -> None:
        """End a batch; if it was in the middle of an input, count a hang."""
        if batch.tried:
            self.note(batch, {"kind": judge.HANG, "code": None, "told": ""})
        batch.end()

    def told(self, seconds: float) -> None:
        """Print all counts."""
        for kind, about in (("lines", "lines of commands"), ("calls", f"calls of {len(CONSTRUCTORS)} constructors")):
            found = {what: count for (of, what), count in self.counts.items() if of == kind}
            print(f"{sum(found.values())} {about}: " + ", ".join(f"{n} {what}" for what, n in sorted(found.items())))
        print(f"{sum(self.wrong.values())} that may not be, at {len(self.wrong)} places, in {seconds:.0f} s")


def tried(options: argparse.Namespace, good: Path, tally: Tally) -> None:
    """Run batches until there were enough examples, or the time is over."""
    began, number, planned = time.monotonic(), options.seed, 0
    running: list[Batch] = []
    while running or planned < options.examples:
        over = time.monotonic() - began > 60 * options.minutes
        while not over and len(running) < options.jobs and planned < options.examples:
            count = min(BATCH, options.examples - planned)
            running.append(Batch("lines" if number % CALLS_EVERY else "calls", number, count, good))
            number, planned = number + 1, planned + count
        if not running:
            return
        ready, _, _ = select.select([batch.reader for batch in running], [], [], 5.0)
        for batch in list(running):
            heard = batch.read() if batch.reader in ready else []
            for values in heard or []:
                tally.heard(batch, values)
            if heard is None or time.monotonic() - batch.heard_s > STUCK_S:
                tally.ended(batch)
                running.remove(batch)


def bench() -> int:
    """Try as many as are asked for, print what was found, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1, help="of the first batch")
    parser.add_argument("--jobs", type=int, default=1, help="batches at once")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no batch after so many")
    parser.add_argument("--log", type=Path, help="file for what may not be, one JSON a line")
    options = parser.parse_args()
    tally, began = Tally(options.log), time.monotonic()
    with judge.without_work(), tempfile.TemporaryDirectory() as home:  # all that commands import is imported here
        make_good(Path(home), synthetic_trial())
        tried(options, Path(home), tally)
    tally.told(time.monotonic() - began)
    return 1 if tally.wrong else 0


if __name__ == "__main__":
    sys.exit(bench())
