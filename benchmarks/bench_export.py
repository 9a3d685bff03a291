"""Time and memory to export trials as a LeRobot data set; the target is 200 episodes in 300 s of two cores.

    python benchmarks/bench_export.py out/ten/session_00/trial_000.npz --episodes 200

One trial, read from its file each time, stands for all episodes.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from trocar.eval.trial import Trial
from trocar.learn.dataset import export_lerobot

TARGET_S, CORES = 300.0, 2


class Repeated(Sequence[Any]):
    """One trial as a sequence of many, each of another session, and each read from the file."""

    def __init__(self, path: Path, count: int):
        self._path, self._count = path, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, number: Any) -> Any:
        if number >= self._count:
            raise IndexError(number)
        trial = Trial.load(self._path)
        return replace(trial, about={**trial.about, "session": number})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trial", type=Path)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--layout", default="lerobot")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        times = []
        for _ in ("first", "again"):
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            done = export_lerobot(Repeated(given.trial, given.episodes), folder, layout=given.layout)
            times.append((time.perf_counter() - wall_s, time.process_time() - cpu_s))
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    (wall_s, cpu_s), again = times
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{done.episodes} episodes, {done.frames} frames, {size / 1e6:.0f} MB; at most {peak:.0f} MB of memory")
    print(
        f"{wall_s:.0f} s on {os.cpu_count()} cores; {cpu_s:.0f} s of processor time, {cpu_s / CORES:.0f} s of {CORES}"
    )
    print(f"all of it there already: {again[0]:.0f} s, {again[1]:.0f} s of processor time")
    share = 200 / done.episodes * cpu_s / CORES / TARGET_S
    print(f"200 episodes: {100 * share:.0f} % of the {TARGET_S:.0f} s allowed, if nothing else runs")


if __name__ == "__main__":
    main()
