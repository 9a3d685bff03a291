"""Speed of the simulator on one core: one calibrated trial of peg transfer, perception included, and where it goes.

Run: ``python benchmarks/bench_simulator.py [SEED]``
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # one core, as under the command line

import cv2  # noqa: E402

from trocar.robots import Calibrated  # noqa: E402
from trocar.sim.camera import RayCamera  # noqa: E402
from trocar.sim.referee import Referee  # noqa: E402
from trocar.sim.robot import SimRobot  # noqa: E402
from trocar.sim.world import World  # noqa: E402
from trocar.trials import Plan, prepare, run_trial  # noqa: E402

BUSY = 0.9
"""Below this share of the real time on the processor, the times are no measurement."""

WATCHED: tuple[tuple[type, str, str], ...] = (
    (World, "step", "physics (MuJoCo)"),
    (SimRobot, "_tick", "controller, servos and cables"),
    (Referee, "observe", "referee"),
    (RayCamera, "render", "rendering, sensor's flaws included"),
    (Calibrated, "corrected", "compensation"),
)


def timed(owner: type, method: str, label: str, seconds: dict[str, float], calls: dict[str, int]) -> None:
    """Replace a method by one that adds up the real time it takes."""
    original: Callable[..., Any] = getattr(owner, method)

    @wraps(original)
    def watched(*args: Any, **kwargs: Any) -> Any:
        begin = time.perf_counter()
        try:
            return original(*args, **kwargs)
        finally:
            seconds[label] += time.perf_counter() - begin
            calls[label] += 1

    setattr(owner, method, watched)


def main(seed: int) -> None:
    """Print the real-time factor of one trial and the real time of its parts."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    plan = Plan(seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        session, models = prepare(plan, Path(folder))
        prepare_s = time.perf_counter() - begin
    seconds: dict[str, float] = defaultdict(float)
    calls: dict[str, int] = defaultdict(int)
    for watched in WATCHED:
        timed(*watched, seconds, calls)
    begin_cpu = time.process_time()
    trial = run_trial(plan, session, models, 0)
    cpu_s = time.process_time() - begin_cpu
    seconds["controller, servos and cables"] -= seconds["physics (MuJoCo)"]
    for computation in trial.computations:
        label = f"{computation.name} of the agent"
        seconds[label] += computation.seconds
        calls[label] += 1
    seconds["everything else"] = trial.wall_s - sum(seconds.values())
    done = sum(bool(transfer["succeeded"]) for transfer in trial.transfers)
    print(f"one trial, seed {seed}: {done} of {len(trial.transfers)} transfers, one core, no pictures")
    print(f"session and calibration   {prepare_s:7.2f} s, once a run")
    print(f"simulated                 {trial.duration_s:7.2f} s")
    print(f"real time                 {trial.wall_s:7.2f} s   (processor {cpu_s:.2f} s)")
    factor, by_cpu = trial.duration_s / trial.wall_s, trial.duration_s / cpu_s
    print(f"real-time factor          {factor:7.2f}     (by the processor's time {by_cpu:.2f})")
    if cpu_s < BUSY * trial.wall_s:
        print("the machine was busy with other work: believe the processor's time, and run again for the parts")
    print(f"{'part':36} {'s':>7} {'share':>6} {'calls':>7} {'ms a call':>10}")
    for label, value in sorted(seconds.items(), key=lambda item: -item[1]):
        count = calls.get(label, 0)
        each = f"{1e3 * value / count:10.3f}" if count else ""
        print(f"{label:36} {value:7.2f} {100 * value / trial.wall_s:5.1f}% {count or '':>7} {each}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
