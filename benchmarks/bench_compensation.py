"""Time to correct commands with each cable model: set-point by set-point, and a whole motion within limits.

Models are fitted to a recording simulated with the identified plant. Times of corrections are processor times. Fitting
the LSTM takes most of the minute.

Run: .venv/bin/python benchmarks/bench_compensation.py [--models play lstm] [--motions N] [--seed N]
"""

import argparse
import os
import time
from itertools import pairwise

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.arms import MOTION_LIMITS, ik
from trocar.calibration.command_path import CommandRequest, command_paths
from trocar.calibration.compensation import HysteresisState, Invertible, inverse
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.motion import limit_use, plan_through
from trocar.robots import TICK_S
from trocar.robots.compensated import RANGE_GUARD

STATION_ARM = load_station("peg-transfer").arm("psm1")
ARM, PAPER = STATION_ARM.model, MOTION_LIMITS["paper"]
SET_POINTS = 300
WASHOUT = 20
"""Set-points after which the cables' past, unknown at the start, no longer matters."""
LOW_M, HIGH_M, REACH_M = 0.010, 0.036, 0.030
"""Transfers go up and down between the two heights over the table, within ``REACH_M`` of its middle in x and y."""


def recording(rng):
    """Return a noisy recording of the plant."""
    q = random_smooth_path(ARM, rng)
    return Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(len(q), bool), 0.8 * np.arange(len(q)))


def transfers(rng, count):
    """Return motions as in peg transfers, each from where the one before ends: up, across, down."""
    T_base_world = STATION_ARM.T_world_base.inverse()
    places = rng.uniform(-REACH_M, REACH_M, (count + 1, 2))
    motions = []
    for start, end in pairwise(places):
        tips_m = [[*start, LOW_M], [*start, HIGH_M], [*end, HIGH_M], [*end, LOW_M]]
        four = ik(ARM, T_base_world @ SE3.from_parts(translation_m=tips_m))
        motions.append(plan_through(ARM, four, PAPER, up=T_base_world.matrix[:3, 2]).trajectory)
    return motions


def point_by_point(model, desired):
    """Return the commands (n, 6) for joints (n, 6) one after the other, and the time (n,) that each took in ms."""
    memory = HysteresisState.at_rest(model, desired[0])
    error = memory.joints(desired[0]) - desired[0]
    q_cmd, times_ms = np.empty_like(desired), np.empty(len(desired))
    for row, q in enumerate(desired):
        begin = time.process_time()
        q_cmd[row] = inverse(model, memory.state, q, q - error)
        joints, memory = memory.step(q_cmd[row])
        error = joints - q_cmd[row]
        times_ms[row] = 1e3 * (time.process_time() - begin)
    return q_cmd, times_ms


def motion_by_motion(model, motions):
    """Return the paths of commands for motions one after the other, and the time (n,) that each took in ms."""
    q, lower, upper = motions[0](0.0), ARM.lower + RANGE_GUARD, ARM.upper - RANGE_GUARD
    memory, paths, times_ms = HysteresisState.at_rest(model, q), [], []
    for motion in motions:
        request = CommandRequest(memory, motion, q, np.zeros(6), PAPER, lower, upper)
        begin = time.process_time()
        path = command_paths({"arm": request})["arm"]
        times_ms.append(1e3 * (time.process_time() - begin))
        end_s = path.commands.duration_s
        q, memory = path.commands(end_s), path.memory_at(end_s)
        paths.append(path)
    return paths, np.array(times_ms)


def measured(kind, rows, desired, motions, rng):
    """Return the figures of one model."""
    begin = time.perf_counter()
    model = kind.fit(rows, rng)
    fit_s = time.perf_counter() - begin
    inverse(model, model.start(desired[0]), desired[0], desired[0])  # the LSTM is compiled when it is called first
    q_cmd, times_ms = point_by_point(model, desired)
    error = (PSM1_GREY.run(np.vstack([desired[:1], q_cmd]))[1:] - desired)[WASHOUT:, 3:]
    paths, motions_ms = motion_by_motion(model, motions)
    set_points = np.array([path.commands.duration_s for path in paths]) / TICK_S
    return {
        "method": "exact" if isinstance(model, Invertible) else "algorithm1",
        "fit_s": fit_s,
        "median_ms": float(np.median(times_ms)),
        "p95_ms": float(np.quantile(times_ms, 0.95)),
        "rmse_rad": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "motion_s": float(np.mean([path.commands.duration_s for path in paths])),
        "motion_median_ms": float(np.median(motions_ms)),
        "motion_p95_ms": float(np.quantile(motions_ms, 0.95)),
        "motion_set_point_ms": float(np.sum(motions_ms) / np.sum(set_points)),
        "motion_stretch": float(np.mean([path.stretch for path in paths])),
        "acceleration_share": max(limit_use(ARM, path.commands, PAPER).acceleration_ratio for path in paths),
    }


def main():
    """Print for each model the times of its fit, of a set-point and of a motion, and the error left in the plant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rows, desired = recording(rng), random_smooth_path(ARM, rng, SET_POINTS)
    motions = transfers(rng, options.motions)
    for name in options.models:
        found = measured(MODELS[name], rows, desired, motions, rng)
        rmse = " ".join(f"{value:.4f}" for value in found["rmse_rad"])
        print(
            f"{name:7s} {found['method']:10s} fit {found['fit_s']:5.1f} s; one set-point {found['median_ms']:.3f} ms "
            f"(p95 {found['p95_ms']:.3f}), RMSE q4 q5 q6 {rmse} rad\n"
            f"{'':18s} one motion of {found['motion_s']:.2f} s {found['motion_median_ms']:.0f} ms "
            f"(p95 {found['motion_p95_ms']:.0f}), {found['motion_set_point_ms']:.3f} ms a set-point; "
            f"slowed down {found['motion_stretch']:.3f} times, up to {found['acceleration_share']:.6f} of the "
            "acceleration",
            flush=True,
        )


if __name__ == "__main__":
    main()
