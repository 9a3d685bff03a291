"""Sutures driven with and without cable compensation, over sessions: success, joints, needle.

Every session is a day of its own, registered and calibrated anew; the interval counts sessions, not sutures. Ten
sessions of four sutures with each method, the default, take some eight minutes.

Run: .venv/bin/python benchmarks/bench_sutures_driven.py [--sessions N] [--sutures N] [--direction clockwise] [--seed N]
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.calibration.plant import PLANTS
from trocar.eval import stopped
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.report.summary import summarise
from trocar.report.tables import figure
from trocar.tasks.suture.report.driven_sutures import SutureReport
from trocar.tasks.suture.task import DIRECTIONS_BY_NAME, CircleSutures

HEAD = (
    "method",
    "sutures",
    "sessions",
    "95 % interval",
    "roll, pitch, yaw RMS deg",
    "tip RMS / max mm",
    "entry, exit max mm",
)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--sutures", type=int, default=4)
    parser.add_argument("--direction", default="best", choices=list(DIRECTIONS_BY_NAME))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    task = CircleSutures(direction=options.direction, sutures=options.sutures)
    runs = [
        RunConfig(task, method=method, sessions=options.sessions, difficulty="mild", seed=options.seed)
        for method in task.methods
    ]
    coverage(runs[0])
    print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
    for config in runs:
        trials = driven(config)
        row(summarise(trials, SutureReport()))
        for trial in trials:
            _, reason = stopped(trial.events)
            if reason:
                print(f"session {trial.about['session']}: {reason}", flush=True)


def driven(config):
    """Return one trial of each session of a run."""
    with tempfile.TemporaryDirectory() as folder:
        return [run_trial(config, prepare(config, number, Path(folder)), 0) for number in range(config.sessions)]


def coverage(config):
    """Print how far the cables' errors over the sutures' joints differ from those over the recorded motion."""
    (name,) = config.arms
    plant, arm = PLANTS["psm1_grey"], config.laboratory.arm(name).model
    for what, box in (("recorded", PSM1_BOX), ("sutures", config.task.calibration(config.laboratory, name))):
        q = random_smooth_path(arm, np.random.default_rng(0), box=box)
        errors = np.degrees(np.sqrt(np.mean((plant.run(q) - q) ** 2, axis=0)))[3:].round(1)
        ends = np.degrees([box.lower[3:], box.upper[3:]]).round()
        print(f"{what}: roll, pitch, yaw from {ends[0]} to {ends[1]} deg, cables' error {errors} deg RMS")


def row(summary):
    low, high = summary["success_ci95"]
    joints = ", ".join(figure(summary["joint_error_deg"][name]["rms"]) for name in ("roll", "wrist_pitch", "wrist_yaw"))
    tip = summary["tip_error_mm"]
    cells = [
        summary["method"],
        f"{summary['succeeded']} of {summary['attempted']}",
        f"{summary['sessions']}",
        f"{100 * low:.0f} to {100 * high:.0f} %",
        joints,
        f"{figure(tip['rms'])} / {figure(tip['max'])}",
        ", ".join(figure(summary[f"{end}_error_mm"]["max"]) for end in ("entry", "exit")),
    ]
    print("| " + " | ".join(cells) + " |", flush=True)
    use = summary["command_limit_use"]
    print(
        f"failures, {summary['method']}: {summary['failures'] or 'none'}; slip at most "
        f"{figure(summary['slip_mm']['max'])} mm; largest share of the limits in the commands sent: velocity "
        f"{use['velocity']:.2f}, acceleration {use['acceleration']:.4f}; "
        f"{summary['mean_time_s']:.1f} s a suture, {summary['realtime_factor']:.1f} x real time",
        flush=True,
    )


if __name__ == "__main__":
    main()
