"""Peg transfer over the network, agent and cell in two processes, compared with the same sessions in one process.

    python benchmarks/bench_crtk_whole_task.py                                  # three variants, ten sessions, ROS 2
    python benchmarks/bench_crtk_whole_task.py --variant unilateral --sessions 1 --ros 1

Every session is one trial of twelve transfers: first in one process ("embedded"), which also fits the cable models;
then ``trocar crtk serve`` in one process and ``trocar run peg-transfer --robot`` in another, with these models, in real
time. The referee of the served cell counts. Trials in ``--out`` are not run again. Needs two idle cores.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from pathlib import Path

from trocar.eval.statistics import session_interval
from trocar.eval.trial import Trial
from trocar.eval.trials import Trials

TROCAR = [sys.executable, "-m", "trocar"]
START_S = 120.0
"""A cell must be served within this time."""


def embedded(folder: Path, variant: str, sessions: int, seed: int, method: str) -> Path:
    """Run the sessions in one process, as far as they are missing; return their folder."""
    out = folder / f"embedded_{variant}"
    words = ["run", "peg-transfer", "--variant", variant, "--method", method, "--seed", str(seed), "--trials", "1"]
    subprocess.run([*TROCAR, *words, "--sessions", str(sessions), "--out", str(out)], check=True)
    return out


def networked(folder: Path, cables: Path, words: list[str], ros: list[str], method: str) -> tuple[Trial, Trial]:
    """Serve a session, let an agent in another process play it; return the agent's trial and the referee's."""
    folder.mkdir(parents=True, exist_ok=True)
    station, variant, seed, session = folder / "served" / "station.toml", *words
    serve = ["crtk", "serve", "peg-transfer", "--task", "peg-transfer", "--option", f"variant={variant}", *ros]
    serve += ["--seed", seed, "--session", session, "--out", str(folder / "served")]
    run = ["run", "peg-transfer", "--variant", variant, "--method", method, "--robot", f"crtk:{station}"]
    run += ["--enable-motion", "--yes", "--seed", seed, "--out", str(folder / "robot")]
    for file in sorted(cables.glob("cables_*.npz")):
        run += ["--cables", f"{file.stem.removeprefix('cables_')}={file}"]
    log = folder / "server.txt"
    with log.open("w") as told, (folder / "client.txt").open("w") as said:
        server = subprocess.Popen([*TROCAR, *serve], stdout=told, stderr=told)
        try:
            deadline_s = time.monotonic() + START_S
            while "serving" not in log.read_text() and time.monotonic() < deadline_s and server.poll() is None:
                time.sleep(0.2)
            subprocess.run([*TROCAR, *run], stdout=said, stderr=said, check=False)
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait()
    return trial_of(folder / "robot"), trial_of(folder / "served")


def trial_of(folder: Path) -> Trial:
    """Return the only trial below a folder."""
    return Trials(sorted(folder.rglob("trial_*.npz")))[0]


def row(name: str, played: list[Trial], judged: list[Trial]) -> tuple[str, float]:
    """Return a line of the table, and the mean time of a trial."""
    good = [sum(score["succeeded"] for score in trial.scores) for trial in judged]
    goals = [len(trial.scores) for trial in judged]
    low, high = session_interval(good, goals)
    time_s = sum(trial.duration_s for trial in played) / len(played)
    told = f"{sum(good)} of {sum(goals)} ({100 * low:.1f} to {100 * high:.1f} %), {time_s:.2f} s a trial"
    return f"  {name}: {told}", time_s


def main() -> None:
    """Run both ways and print them beside each other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variant", nargs="*", default=["unilateral", "bilateral", "handover"])
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--seed", type=int, default=20261125)
    parser.add_argument("--method", default="best")
    parser.add_argument("--ros", type=int, default=2)
    parser.add_argument("--domain", type=int, default=78)
    parser.add_argument("--master", default="http://127.0.0.1:11311")
    parser.add_argument("--out", type=Path, default=Path("out/bench_crtk_whole_task"))
    given = parser.parse_args()
    ros = ["--ros", str(given.ros), "--domain", str(given.domain), "--master", given.master]
    for variant in given.variant:
        alone = embedded(given.out, variant, given.sessions, given.seed, given.method)
        played, judged = [], []
        for session in range(given.sessions):
            folder = given.out / f"ros{given.ros}_{variant}_{session:02d}"
            if not list(folder.glob("served/session_*/trial_*.npz")):
                words = [variant, str(given.seed), str(session)]
                networked(folder, alone / f"session_{session:02d}", words, ros, given.method)
            played.append(trial_of(folder / "robot"))
            judged.append(trial_of(folder / "served"))
            print(f"{variant}, session {session + 1}: {played[-1].ended} {played[-1].reason}", flush=True)
        both = [trial_of(alone / f"session_{session:02d}") for session in range(given.sessions)]
        first, before_s = row("embedded", both, both)
        second, after_s = row(f"over ROS {given.ros}", played, judged)
        told = [sum(score["succeeded"] for score in trial.scores) for trial in played]
        print(f"{variant}, {given.method}, {given.sessions} sessions of seed {given.seed}\n{first}\n{second}")
        change = 100 * (after_s / before_s - 1)
        print(f"  time {change:+.1f} %; the script itself says {sum(told)} transfers", flush=True)


if __name__ == "__main__":
    main()
