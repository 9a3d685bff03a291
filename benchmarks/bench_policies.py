"""Learned policies on raw and on compensated cables: one transfer, scored by the referee.

Scores scripts and policies in new sessions, with raw and with compensated cables, at two difficulties; prints the table
and draws the picture of ``docs/learning.md``. Policies are folders in POLICIES: ``mlp-raw`` and ``mlp-calibrated`` as
``examples/chunked_mlp.py`` writes them, ``act-raw`` and ``act-calibrated`` as ``examples/lerobot_act.py`` does; missing
ones are left out. After an interruption, the same command resumes.

Run: .venv/bin/python benchmarks/bench_policies.py POLICIES --lerobot PYTHON --out out/policies
"""

from __future__ import annotations

import argparse
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import trocar
from trocar.eval.statistics import session_interval
from trocar.learn.policy import policy_digest
from trocar.report import style

WAYS = ("raw", "calibrated")
SCRIPTS = {"raw": "uncalibrated", "calibrated": "best"}
DIFFICULTIES = ("mild", "recorded")
SERVER = Path(__file__).parents[1] / "examples" / "lerobot_server.py"
PORT = 5599
"""Always the same: a policy's address is part of its run, which could not be resumed with another port."""


@contextmanager
def served(python: str, folder: Path) -> Iterator[str]:
    """Serve a policy of LeRobot; yield its address once it answers."""
    command = [python, str(SERVER), str(folder), "--port", str(PORT)]
    server = subprocess.Popen(command, env={**os.environ, "HF_HUB_OFFLINE": "1"}, stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        if b"serving" not in server.stdout.readline():
            raise SystemExit(f"{folder} could not be served")
        yield f"tcp://127.0.0.1:{PORT}"
    finally:
        server.terminate()
        server.wait()


def scored(given: argparse.Namespace, name: str, way: str, difficulty: str, how: dict[str, Any]) -> dict[str, Any]:
    """Run one cell of the table; return its counts, with an interval that counts sessions."""
    trials = trocar.run(
        "peg-transfer",
        transfers=1,
        budget_s=20.0,
        difficulty=difficulty,
        seed=given.seed,
        sessions=given.sessions,
        trials=given.trials,
        jobs=given.jobs,
        out=given.out / f"{name}-{way}-{difficulty}",
        **({"calibration": given.calibration} if way == "calibrated" else {}),
        **how,
    )
    done, tried = np.zeros(given.sessions, int), np.zeros(given.sessions, int)
    seconds, hits = [], 0
    for trial in trials:
        done[trial.about["session"]] += bool(trial.scores[0]["succeeded"])
        tried[trial.about["session"]] += 1
        hits += len(trial.collisions)
        seconds += [trial.duration_s] if trial.scores[0]["succeeded"] else []
    low, high = session_interval(done.tolist(), tried.tolist())
    row = {
        "done": int(done.sum()),
        "tried": int(tried.sum()),
        "low": low,
        "high": high,
        "collisions": hits / len(trials),
    }
    middle = f"{np.median(seconds):.1f} s" if seconds else "-"
    share, interval = 100 * row["done"] / row["tried"], f"{100 * low:.0f} to {100 * high:.0f} %"
    counts = f"{row['done']} of {row['tried']} ({share:.0f} %, {interval})"
    print(f"| {name} | {way} | {difficulty} | {counts} | {middle} | {row['collisions']:.2f} |", flush=True)
    return row


def learned(given: argparse.Namespace, name: str, way: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each difficulty and how this policy is run there."""
    folder = given.policies / f"{name}-{way}"
    method = "policy-calibrated" if way == "calibrated" else "policy"
    if not folder.is_dir():
        return
    settings: dict[str, object] = {"observation": "state,objects", "timeout_s": 60.0}
    if name == "mlp":
        settings |= {"policy": str(folder), "policy_digest": policy_digest(str(folder))}
        yield from ((difficulty, {"method": method, "settings": settings}) for difficulty in DIFFICULTIES)
        return
    with served(given.lerobot, folder) as address:
        for difficulty in DIFFICULTIES:
            yield difficulty, {"method": method, "settings": settings | {"policy": address}}


def draw(rows: dict[tuple[str, str, str], dict[str, Any]], figure: Figure) -> None:
    """Draw the success rates as dots with their intervals, a chart for each difficulty."""
    figure.set_size_inches(7.4, 3.0)
    names = list(dict.fromkeys(name for name, _, _ in rows))
    grid = figure.subplots(1, len(DIFFICULTIES), sharey=True)
    for axes, difficulty in zip(grid, DIFFICULTIES, strict=True):
        for shift, way, colour in ((-0.12, "raw", style.VERMILION), (0.12, "calibrated", style.BLUE)):
            at = [k for k, name in enumerate(names) if (name, way, difficulty) in rows]
            found = [rows[names[k], way, difficulty] for k in at]
            share = np.array([100 * row["done"] / row["tried"] for row in found])
            ends = np.array([[100 * row["low"], 100 * row["high"]] for row in found]).T
            x, label = np.array(at) + shift, {"raw": "raw cables", "calibrated": "compensated"}[way]
            axes.errorbar(x, share, np.abs(ends - share), fmt="o", color=colour, capsize=3, label=label)
        axes.set_xticks(range(len(names)), [{"mlp": "MLP", "act": "ACT"}.get(name, name) for name in names])
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylim(-4, 104)
        axes.set_title(difficulty)
    grid[0].set_ylabel("transfers done, %")
    grid[1].legend(loc="lower right")


def main() -> None:
    """Score every cell of the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", type=Path)
    parser.add_argument("--lerobot", default="python", help="Python of LeRobot's environment.")
    parser.add_argument("--out", type=Path, default=Path("out/policies"))
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--seed", type=int, default=20270900)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--calibration", default="images")
    given = parser.parse_args()
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    began = time.monotonic()
    print("| who | cables | difficulty | transfers (95 %, by session) | time | collisions |")
    print("|---|---|---|---|---|---|")
    for way in WAYS:
        for difficulty in DIFFICULTIES:
            rows["script", way, difficulty] = scored(given, "script", way, difficulty, {"method": SCRIPTS[way]})
    for name in ("mlp", "act"):
        for way in WAYS:
            for difficulty, how in learned(given, name, way):
                rows[name, way, difficulty] = scored(given, name, way, difficulty, how)
    given.out.mkdir(parents=True, exist_ok=True)
    picture = style.picture(lambda figure: draw(rows, figure))
    picture.savefig(given.out / "policies.png", dpi=style.DPI)
    print(f"{given.out / 'policies.png'}; {(time.monotonic() - began) / 60:.0f} minutes")


if __name__ == "__main__":
    main()
