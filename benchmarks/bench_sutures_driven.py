"""Sutures driven with and without cable compensation, in a fresh session a seed: success, joints, needle.

Run: .venv/bin/python benchmarks/bench_sutures_driven.py [--seeds N] [--direction clockwise]
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.arms import ARMS
from trocar.calibration.excitation import PSM1_BOX, random_smooth_path
from trocar.calibration.plant import PLANTS
from trocar.report import summarise
from trocar.report.statistics import wilson_interval
from trocar.tasks import CircleSutures
from trocar.trials import METHODS, Plan, prepare, run_trial


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--direction", default="best")
    options = parser.parse_args()
    coverage()
    print("| method | sutures | 95 % interval | roll, pitch, yaw RMS deg | tip RMS / max mm | entry, exit max mm |")
    print("|---|---|---|---|---|---|")
    for method in METHODS:
        trials = []
        for seed in range(1, options.seeds + 1):
            plan = Plan("suture", method=method, seed=seed, direction=options.direction)
            with tempfile.TemporaryDirectory() as folder:
                trials.append(run_trial(plan, *prepare(plan, Path(folder)), 0))
        row(method, summarise(trials))


def coverage():
    """Print how far the cables' errors over the sutures' joints differ from those over the recorded motion."""
    plant, arm = PLANTS["psm1_grey"], ARMS["psm-classic"]
    for name, box in (("recorded", PSM1_BOX), ("sutures", CircleSutures().excitation)):
        q = random_smooth_path(arm, np.random.default_rng(0), box=box)
        errors = np.degrees(np.sqrt(np.mean((plant.run(q) - q) ** 2, axis=0)))[3:].round(1)
        ends = np.degrees([box.lower[3:], box.upper[3:]]).round()
        print(f"{name}: roll, pitch, yaw from {ends[0]} to {ends[1]} deg, cables' error {errors} deg RMS")


def row(method, summary):
    low, high = wilson_interval(summary["succeeded"], summary["attempted"])
    joints = ", ".join(
        f"{summary['joint_error_deg'][name]['rms']:.2f}" for name in ("roll", "wrist_pitch", "wrist_yaw")
    )
    tip = summary["tip_error_mm"]
    ends = [summary[f"{end}_error_mm"]["max"] for end in ("entry", "exit")]
    shown = ["-" if value is None else f"{value:.2f}" for value in ends]
    print(
        f"| {method} | {summary['succeeded']} of {summary['attempted']} | {100 * low:.0f} to {100 * high:.0f} % | "
        f"{joints} | {tip['rms']:.2f} / {tip['max']:.2f} | {shown[0]}, {shown[1]} |",
        flush=True,
    )
    print(
        f"failures, {method}: {summary['failures'] or 'none'}; slip at most {summary['slip_mm']['max']:.2f} mm",
        flush=True,
    )
    for sentence in summary["stopped"]:
        print(sentence)


if __name__ == "__main__":
    main()
