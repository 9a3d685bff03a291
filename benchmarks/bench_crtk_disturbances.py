"""Disturb a task over CRTK at random times: do arms stop within their limits, is the fault named, the trial saved?

Two arms move blocks on a served cell (``trocar run peg-transfer --robot``, ``trocar crtk serve``). Processes are killed
or paused, sockets dropped, streams frozen, and the machine kept busy. Each try is one line of ``OUT/tries.jsonl``; the
same command resumes where it stopped. The files of tries that went wrong stay in ``OUT/wrong``.

    python benchmarks/bench_crtk_disturbances.py                           # 20 tries, five minutes
    python benchmarks/bench_crtk_disturbances.py --times 200 --out out/200
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import signal
import sys
import time
from collections import Counter
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from disturbances import (
    BUDGET_S,
    END_S,
    KINDS,
    SHORT_S,
    START_S,
    STATION,
    VARIANT,
    Done,
    Process,
    Robot,
    Scene,
    happen,
    until,
)
from served_record import TICK_SERVOS

from trocar.errors import TrocarError
from trocar.eval.trial import Trial, trial_file
from trocar.hardware.arm import PASSING, Fault

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from crtk_partners import python_of, ros1_master

MOST_RATIO = 1.001
WITHIN_S = 3.5
"""Arms are disturbed within this time after they begin to move."""
FAULT_S = 6.5
"""A planted fault begins this long after the robot's start, or up to ``WITHIN_S`` later: the arms move by then."""
REST_S = 3.0
"""Arms must be at rest within this time after the client has ended."""
KEPT = 8
"""Number of tries per robot: after these, few blocks are left where the task expects them."""
ANSWERED_S = (0.07, 0.09)
"""An arm that moves between these times after the disturbance was moving when it began."""


@dataclass
class Try:
    """What happened in a try, and what is wrong with it.

    Attributes:
        number: of the try.
        kind: of the disturbance.
        what: the disturbance in words.
        at_s: time of the disturbance, from the first motion of the arms.
        velocity: largest velocity of the robot's arms as a share of its limit; ``acceleration`` likewise.
        faults: those that the client named.
        ended: how the client's trial ended; ``reason`` says why.
        started: whether the arms moved; with a planted fault, they need not.
        started_s: time until the arms moved.
        seconds: duration of the whole try.
        wrong: what went wrong, in sentences.
    """

    number: int
    kind: str
    what: str = ""
    at_s: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0
    faults: list[str] = field(default_factory=list)
    ended: str = ""
    reason: str = ""
    started: bool = True
    started_s: float = 0.0
    seconds: float = 0.0
    wrong: list[str] = field(default_factory=list)


class Bench:
    """Runs tries in turn; keeps a robot while it is sound."""

    def __init__(self, out: Path, seed: int, words: list[str], python: str):
        self._out, self._seed, self._words, self._python = out, seed, words, python
        self._robot: Robot | None = None
        self._used = 0
        self._client_out: Path | None = None

    def attempt(self, number: int, kind: str = "") -> Try:
        """Do one try, of the given kind or of a random one."""
        rng, began_s = random.Random(f"{self._seed}-{number}"), time.monotonic()
        kind = kind or rng.choice(list(KINDS))
        found = Try(number, kind)
        robot = self._fresh(KINDS[kind].plant, FAULT_S + rng.uniform(0, WITHIN_S))
        first = len(robot.record)
        out = self._client_out or self._out / f"client-{number:03d}"
        line = ["run", STATION, "--variant", VARIANT, "--budget", BUDGET_S, "--seed", 1, "--method", "uncalibrated"]
        line += ["--robot", f"crtk:{robot.station}", "--enable-motion", "--yes", "--out", out]
        client = Process(line, self._out / f"client-{number:03d}.log", {}, self._python)
        if not until(lambda: robot.record.moving(first) or client.code is not None, START_S) or client.code is not None:
            found.started = False
        moved_s = time.monotonic()
        found.started_s = round(moved_s - began_s, 2)
        time.sleep(0 if KINDS[kind].plant or client.code is not None else rng.uniform(0, WITHIN_S))
        at_s = time.monotonic()
        found.at_s = round(at_s - moved_s, 2)
        done = happen(KINDS[kind], Scene(client, robot, rng, moved_s))
        found.what = done.what
        if not found.started:  # it was refused, and says why
            found.reason = client.log.read_text().strip().rpartition("\n")[2]
        if not found.started and not (KINDS[kind].plant and client.code):
            found.wrong.append("the arms did not begin to move")
        if not client.ended(END_S):
            found.wrong.append(f"the client did not end within {END_S:g} s")
        found.wrong += [f"left behind: {line}" for line in client.clear(5.0)]
        until(lambda: robot.record.use(first).at_rest, REST_S)
        use = robot.record.use(first)
        found.velocity, found.acceleration = use.velocity, use.acceleration
        if max(use.velocity, use.acceleration) > MOST_RATIO:
            found.wrong.append(f"beyond the limits: velocity {use.velocity:.4f}, acceleration {use.acceleration:.4f}")
        if not use.at_rest and robot.process.code is None:
            found.wrong.append(f"not at rest {REST_S:g} s after the client's end")
        rows = robot.record.rows(first)
        near = (rows[:, 0] > at_s + ANSWERED_S[0]) & (rows[:, 0] < at_s + ANSWERED_S[1])
        moving = bool(rows[near, 2 + 6 * TICK_SERVOS :].any())
        trial = trial_file(out, 0, 0)
        cut_off = kind == "script killed" and not trial.is_file()  # else a fault had ended it before
        self._client_out = out if cut_off else None  # the next try resumes this run
        if not cut_off and (found.started or not client.code):
            self._judge(found, trial, client, done, moving)
        found.wrong += [f"half-written: {path}" for path in out.rglob("*.part*")]
        if not done.robot_is_well or found.wrong:
            self.end()
        found.seconds = round(time.monotonic() - began_s, 1)
        self._tidy(found, out)
        return found

    def _judge(self, found: Try, path: Path, client: Process, done: Done, moving: bool) -> None:
        """Check the client's exit code and its trial."""
        kind = KINDS[found.kind]
        if client.code != 0 and found.kind != "script killed":
            found.wrong.append(f"the client's exit code is {client.code}")
        try:
            trial = Trial.load(path)
        except TrocarError as error:
            found.wrong.append(f"no trial: {error}")
            return
        named = {event["fault"] for event in trial.events if event["name"] == "fault"}
        found.faults, found.ended, found.reason = sorted(named), trial.ended, trial.reason
        wanted = {fault.name.lower() for fault in kind.faults}
        if wanted and done.lasted_s > SHORT_S and (moving or not kind.moving) and not named & wanted:
            found.wrong.append(f"the client names {sorted(named)}, none of {sorted(wanted)}")
        if named - {fault.name.lower() for fault in PASSING} and not (trial.ended == "FAULT" and trial.reason):
            found.wrong.append(f"the trial ended by {trial.ended!r} ({trial.reason!r}) in spite of {sorted(named)}")
        if max(max(use) for use in trial.command_limit_use.values()) > MOST_RATIO:
            found.wrong.append(f"what was sent: {trial.command_limit_use}")
        ends = [trial.arrays[f"commanded_{arm}"][-2:, :6] for arm in trial.arms]
        if Fault.GONE.name.lower() not in named and any(len(end) and np.ptp(end, axis=0).any() for end in ends):
            found.wrong.append("the client's record breaks off while an arm moves")

    def _fresh(self, plant: str, fault_s: float) -> Robot:
        """Return a sound robot, a new one if need be."""
        if plant or self._used == KEPT:
            self.end()
        if self._robot is None:
            shutil.rmtree(self._out / "robot", ignore_errors=True)
            self._used = 0
            self._robot = Robot(self._out / "robot", plant, fault_s, self._words, self._python)
        self._used += 1
        return self._robot

    def end(self) -> None:
        """End the robot."""
        if self._robot is not None:
            self._robot.stop()
            self._robot = None

    def _tidy(self, found: Try, out: Path) -> None:
        """Keep the files of a try that went wrong, and no others."""
        log = self._out / f"client-{found.number:03d}.log"
        if found.wrong:
            wrong = self._out / "wrong" / f"{found.number:03d}"
            shutil.rmtree(wrong, ignore_errors=True)
            wrong.mkdir(parents=True)
            for path in (out, log, self._out / "robot"):
                if path.exists() and path != self._client_out:
                    shutil.move(path, wrong / path.name)
        else:
            log.unlink()
            if out != self._client_out:
                shutil.rmtree(out)


def told(found: Try) -> str:
    """Return a try in one line."""
    when = f"{found.number:3d} {found.seconds:4.0f} s, moved after {found.started_s:.0f} s"
    named = ", ".join(found.faults) or "no fault"
    return f"{when}: {found.kind}: {found.what}, {found.at_s:.1f} s later; {named}; {found.ended}: {found.reason}"


def table(tries: list[Try]) -> str:
    """Return the results by kind."""
    lines = [f"{'what happened':<22}{'tries':>6}{'wrong':>6}{'velocity':>10}{'accel.':>8}  the client named"]
    for kind in [*KINDS, ""]:
        mine = [one for one in tries if one.kind == kind or not kind]
        if mine:
            names = Counter(name for one in mine for name in one.faults)
            named = ", ".join(f"{name} {count}" for name, count in names.most_common())
            worst = max(one.velocity for one in mine), max(one.acceleration for one in mine)
            counts = f"{len(mine):>6}{sum(bool(one.wrong) for one in mine):>6}"
            lines.append(f"{kind or 'all':<22}{counts}{worst[0]:>10.4f}{worst[1]:>8.4f}  {named}")
    return "\n".join(lines)


def main() -> int:
    """Do what is still to do, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=20, help="how many tries")
    parser.add_argument("--seed", type=int, default=1, help="of what happens, and when")
    parser.add_argument("--ros", type=int, choices=(1, 2), default=2, help="1 needs .ros1, from tools/ros1.sh")
    parser.add_argument("--out", type=Path, default=Path("out/disturbances"), help="folder of the tries")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # else processes would be left behind
    out = options.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    lines = out / "tries.jsonl"
    tries = [Try(**json.loads(line)) for line in lines.read_text().splitlines()] if lines.is_file() else []
    with ros1_master() if options.ros == 1 else nullcontext("") as master:
        words, python = (["--ros", "1", "--master", master], str(python_of(1))) if master else ([], sys.executable)
        bench = Bench(out, options.seed, words, python)
        try:
            for number in range(len(tries), options.times):
                found = bench.attempt(number)
                tries.append(found)
                with lines.open("a") as file:
                    file.write(f"{json.dumps(asdict(found))}\n")
                print(told(found), flush=True)
                for wrong in found.wrong:
                    print(f"    WRONG: {wrong}", flush=True)
        finally:
            bench.end()
    print(table(tries))
    return 1 if any(one.wrong for one in tries) else 0


if __name__ == "__main__":
    sys.exit(main())
