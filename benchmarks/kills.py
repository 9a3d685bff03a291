"""Kill runs at random times (SIGKILL), resume them, and compare all their files with those of an uninterrupted run.

    python benchmarks/kills.py --kills 200 --out out/kills

Each round kills a run one to six times: while cables are calibrated, within trials, between them, or while the report
is drawn. Times are drawn over the duration of an uninterrupted run, early ones more often than late ones, since a
resumed run has less to do. Then the same command finishes. Its files must equal those of the uninterrupted run byte for
byte, except for real times of computations, and no other file may be left behind. Runs are forked from a process that
has imported everything, so that kills strike work and not imports; uninterrupted runs are processes of their own.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import trocar.eval.run
import trocar.report.files
import trocar.sim.offscreen
import trocar.view.replay  # noqa: F401
from trocar.cli import main

PEG = "run peg-transfer --transfers 1"
RUNS = {
    "uncalibrated": f"{PEG} --method uncalibrated --sessions 1 --trials 2 --seed 3",
    "calibrated": f"{PEG} --calibration joints --sessions 2 --trials 1 --seed 3 --new-session --refit-offsets",
    "two at once": f"{PEG} --method uncalibrated --sessions 2 --trials 1 --seed 4 --jobs 2",
    "suture": "run suture --count 1 --method blind --budget 20 --trials 2 --seed 3",
    "debridement": "run debridement --fragments 1 --budget 6 --trials 2 --seed 3",
}
"""Short runs, by name; whether they reach their goals does not matter here."""
MAX_KILLS_A_ROUND = 6
OF_REAL_TIME = ("compute_ms", "missed_budgets", "realtime_factor", "wall_s_per_trial")
"""Keys of a summary, and of the tables in it, that depend on the machine's speed."""
REAL_TIME_ROWS = re.compile(
    rb"\s*<p class=warning>[^<]* of computations took longer.*?</p>"
    rb"|<tr><th scope=row>(?:computations|speed of the simulation)[^<]*</th><td>[^<]*</td></tr>"
)
"""The parts of a report's page that state real times."""
ENDED = (0, 1)
"""Exit codes of a run that came to its end: all goals reached, or some missed."""


@dataclass(frozen=True)
class Peace:
    """An uninterrupted run: its files, and how long it took once everything was imported."""

    files: dict[str, Any]
    seconds: float


def contents(folder: Path) -> dict[str, Any]:
    """Return the contents of a run's files by name, without real times."""
    found: dict[str, Any] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = str(path.relative_to(folder))
        if name.endswith(".timing.json"):
            found[name] = "real times"
        elif name == "summary.json":
            found[name] = without_real_times(json.loads(path.read_text()))
        elif name == "report.html":
            found[name] = REAL_TIME_ROWS.sub(b"", path.read_bytes())
        else:
            found[name] = path.read_bytes()
    return found


def without_real_times(values: Any) -> Any:
    """Return JSON's values without the keys that depend on the machine's speed."""
    if not isinstance(values, dict):
        return values
    return {key: without_real_times(value) for key, value in values.items() if key not in OF_REAL_TIME}


def forked(words: list[str], folder: Path) -> int:
    """Begin a command in a forked process with its own group, and return its process id."""
    number = os.fork()
    if number == 0:
        os.setpgid(0, 0)
        log = os.open(folder.with_suffix(".log"), os.O_CREAT | os.O_WRONLY | os.O_APPEND)
        os.dup2(log, 1)
        os.dup2(log, 2)
        sys.argv = ["trocar", *words, "--out", str(folder)]
        try:
            main()
        except SystemExit as end:
            code = end.code
            os._exit(code if isinstance(code, int) else 0)
        finally:
            os._exit(99)
    return number


def waited(number: int, seconds: float | None) -> int | None:
    """Return the exit code of a process; None if it still runs after ``seconds``."""
    deadline = None if seconds is None else time.monotonic() + seconds
    while deadline is None or time.monotonic() < deadline:
        done, status = os.waitpid(number, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    return None


def left_in_peace(words: list[str], out: Path) -> Peace:
    """Run a command uninterrupted, and again in a forked process, which is timed; both must write the same files."""
    shutil.rmtree(out, ignore_errors=True)
    line = [sys.executable, "-m", "trocar", *words, "--out", str(out)]
    code = subprocess.run(line, stdout=subprocess.DEVNULL, check=False).returncode
    files = contents(out)
    shutil.rmtree(out)
    began = time.monotonic()
    again = waited(forked(words, out), None)
    seconds = time.monotonic() - began
    if code not in ENDED or again != code:
        raise SystemExit(f"{' '.join(words)} ended with {code} and {again} where it was left in peace; see {out}.log")
    if wrong := differences(files, contents(out)):
        raise SystemExit(f"{' '.join(words)} writes something else each time: {', '.join(wrong)}")
    return Peace(files, seconds)


def differences(wanted: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Return the names of files that differ, are missing or are left behind."""
    names = sorted(wanted.keys() | found.keys())
    return [
        f"{name} ({'missing' if name not in found else 'left behind' if name not in wanted else 'other content'})"
        for name in names
        if wanted.get(name) != found.get(name)
    ]


def state_of(folder: Path) -> str:
    """Return how far a run had come."""
    names = {path.name for path in folder.rglob("*")} if folder.is_dir() else set()
    if any(".part" in name for name in names):
        return "while a file was written"
    if "summary.json" in names:
        return "while its report was drawn"
    trials = sum(name.startswith("trial_") and name.endswith(".npz") for name in names)
    if trials:
        return f"after {trials} trial{'s' * (trials > 1)}"
    return "in its first trial" if any(name.startswith("cables_") for name in names) else "before its first trial"


def one_round(words: list[str], peace: Peace, folder: Path, rng: random.Random) -> tuple[list[str], list[str]]:
    """Kill a run some times and let it finish; return when it was killed, and what is wrong with its files."""
    shutil.rmtree(folder, ignore_errors=True)
    struck: list[str] = []
    for _ in range(rng.randint(1, MAX_KILLS_A_ROUND)):
        number = forked(words, folder)
        if waited(number, peace.seconds * rng.random() ** 2) is None:
            os.killpg(number, signal.SIGKILL)
            os.waitpid(number, 0)
            struck.append(state_of(folder))
    code = waited(forked(words, folder), None)
    wrong = [] if code in ENDED else [f"exit code {code}"]
    return struck, wrong + differences(peace.files, contents(folder))


def asked() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="how many; the last round may exceed it")
    parser.add_argument("--seed", type=int, default=1, help="of the times")
    parser.add_argument("--runs", nargs="+", choices=RUNS, default=list(RUNS), help="which, in turn")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no round after so many")
    parser.add_argument("--out", type=Path, default=Path("out/kills"), help="folder for all runs")
    return parser.parse_args()


def bench() -> int:
    """Kill as many as are asked for, print what was found, and return the exit code."""
    options, rng, began = asked(), random.Random(), time.monotonic()
    rng.seed(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    when, rounds, failed = Counter[str](), Counter[str](), 0
    peaces: dict[str, Peace] = {}
    while when.total() < options.kills and time.monotonic() - began < 60 * options.minutes:
        name = options.runs[rounds.total() % len(options.runs)]
        words, folder = RUNS[name].split(), options.out.absolute() / name.replace(" ", "-")
        if name not in peaces:
            peaces[name] = left_in_peace(words, folder)
            print(f"{name}: {len(peaces[name].files)} files, {peaces[name].seconds:.0f} s", flush=True)
        struck, wrong = one_round(words, peaces[name], folder, rng)
        when.update(struck)
        rounds[name] += 1
        failed += bool(wrong)
        print(f"{when.total():4d} kills; {name}: {', '.join(struck) or 'ended before it was struck'}", flush=True)
        if wrong:
            print(f"     WRONG: {', '.join(wrong)}", flush=True)
            folder.rename(folder.with_name(f"{folder.name}-wrong-{failed}"))
    print(f"{when.total()} kills in {rounds.total()} runs, {failed} of which ended otherwise than one left in peace")
    for count, state in sorted(((count, state) for state, count in when.items()), reverse=True):
        print(f"{count:4d} {state}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(bench())
