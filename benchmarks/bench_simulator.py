"""Speed of the simulator on one core: a calibrated trial of peg transfer, with perception, and where the time goes.

Run: .venv/bin/python benchmarks/bench_simulator.py [--seed N] [--transfers N]; all twelve transfers take half a minute.
"""

# ruff: noqa: E402 (the number of threads is read when libraries are imported)
from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from functools import wraps
from pathlib import Path
from typing import Any

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # one core, as under the command line

import cv2

from trocar.cell import Cell
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.log import REFERENCE_S, _reference, timed
from trocar.robots import Compensated, Guarded
from trocar.sim.ray_camera import RayCamera
from trocar.sim.record import ContactMonitor, Recorder
from trocar.sim.robot import SimRobot
from trocar.sim.world import World
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.tasks.peg_transfer.world import PegWorld

BUSY = 0.9
"""If processor time is less than this share of real time, the machine was too busy for a measurement."""

WATCHED: tuple[tuple[type, str, str], ...] = (
    (World, "step", "physics (MuJoCo)"),
    (SimRobot, "tick", "controller, servos and cables"),
    (Guarded, "check", "guard, while arms move"),
    (PegWorld, "observe", "referee"),
    (ContactMonitor, "observe", "collisions"),
    (Recorder, "observe", "recorder"),
    (RayCamera, "render", "rendering, sensor's flaws included"),
    (Compensated, "_found", "compensation"),
)


def mean_speed(runs: int = 20) -> float:
    """Return the machine's mean speed over some runs, as a multiple of the reference's.

    ``trocar.log.machine_speed`` takes the fastest run, which on a noisy machine is a burst that no trial keeps up.
    """
    return REFERENCE_S * runs / sum(timed(_reference)[1] for _ in range(runs))


class Stopwatch:
    """Adds up the real time of functions, without that of other watched functions that they call.

    Attributes:
        seconds: by label.
        calls: by label.
    """

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self._inner_s: list[float] = []

    def watched(self, function: Callable[..., Any], label: str) -> Callable[..., Any]:
        """Return the function with its time added up under a label."""

        @wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            self._inner_s.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                taken_s = time.perf_counter() - begin
                self.seconds[label] += taken_s - self._inner_s.pop()
                self.calls[label] += 1
                if self._inner_s:
                    self._inner_s[-1] += taken_s

        return timed

    def watch(self) -> None:
        """Watch the parts of the simulator and the agents' computations, for the rest of this process."""
        for owner, method, label in WATCHED:
            setattr(owner, method, self.watched(getattr(owner, method), label))
        compute = Cell.compute

        def computed(cell: Cell, arm: str, name: str, function: Callable[[], Any], budget_s: float) -> Awaitable[Any]:
            return compute(cell, arm, name, self.watched(function, f"{name} of the agent"), budget_s)

        Cell.compute = computed


def main(seed: int, transfers: int) -> None:
    """Print the real-time factor of one trial and the real time of its parts."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    config = RunConfig(PegTransfer(transfers=transfers), method="calibrated", seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        prepared = prepare(config, 0, Path(folder))
        prepare_s = time.perf_counter() - begin
    stopwatch = Stopwatch()
    stopwatch.watch()
    before = mean_speed()
    begin_cpu = time.process_time()
    trial = run_trial(config, prepared, 0)
    cpu_s = time.process_time() - begin_cpu
    seconds = {**stopwatch.seconds, "everything else": trial.wall_s - sum(stopwatch.seconds.values())}
    done = sum(bool(score["succeeded"]) for score in trial.scores)
    print(f"one trial, seed {seed}: {done} of {len(trial.scores)} transfers, one core, no pictures")
    print(f"session and calibration   {prepare_s:7.2f} s, once a session")
    print(f"simulated                 {trial.duration_s:7.2f} s")
    print(f"real time                 {trial.wall_s:7.2f} s   (processor {cpu_s:.2f} s)")
    factor, by_cpu = trial.duration_s / trial.wall_s, trial.duration_s / cpu_s
    print(f"real-time factor          {factor:7.2f}     (by the processor's time {by_cpu:.2f})")
    speed = (before + mean_speed()) / 2
    print(f"at the reference's speed  {by_cpu / speed:7.2f}     (this machine is {speed:.2f} times as fast as that)")
    if cpu_s < BUSY * trial.wall_s:
        print("the machine was busy with other work: believe the processor's time, and run again for the parts")
    print(f"{'part':36} {'s':>7} {'share':>6} {'calls':>7} {'ms a call':>10}")
    for label, value in sorted(seconds.items(), key=lambda item: -item[1]):
        count = stopwatch.calls[label]
        each = f"{1e3 * value / count:10.3f}" if count else ""
        print(f"{label:36} {value:7.2f} {100 * value / trial.wall_s:5.1f}% {count or '':>7} {each}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--transfers", type=int, default=12, help="of the twelve, the first so many")
    options = parser.parse_args()
    main(options.seed, options.transfers)
