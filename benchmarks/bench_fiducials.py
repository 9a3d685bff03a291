"""Calibration from images: what an image costs, and how many the cable model needs.

An arm of the peg transfer's station is collected once; `play` is fitted on its first rows, and compared with the cables
alone (without what does not repeat) on another motion. Beside it: as many joints with drawn noise, and no images. Times
are the processor's. Two minutes an arm.
The cell is `mild`.

Run: .venv/bin/python benchmarks/bench_fiducials.py [--rows N] [--seed N] [--json]
"""

import argparse
import json
import os
import time
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.collect.collection import Collection
from trocar.lab import load_station
from trocar.lab.flaws import Difficulty
from trocar.lab.session import draw_session
from trocar.sim.calibration_cells import record_motion

PARTS = (200, 400, 650, 900, 1357)
"""Rows that a model is fitted on."""
OTHER_ROWS, WASHOUT = 800, 30
"""Rows of the other motion; at its beginning the cables' past is unknown."""


def wrist_rmse(recording, rows, q, true):
    model = MODELS["play"].fit(recording.first(min(rows, len(recording))), np.random.default_rng(0))
    error = (model.predict(q) - true)[WASHOUT:, 3:]
    return np.sqrt(np.mean(error**2, axis=0)).tolist()


def measure(arm, rows, seed):
    station = replace(load_station("peg-transfer"), difficulty=Difficulty.of("mild"))
    session = draw_session(station, np.random.default_rng([seed, 0]))
    box, model = station.arm(arm).calibration, station.arm(arm).model
    collection = Collection(session, arm, box, np.random.SeedSequence([seed, 1, list(station.arms).index(arm)]), rows)
    began = time.process_time()
    centers = collection.run()
    image_ms = 1e3 * (time.process_time() - began) / rows
    measured = collection.measured(centers)
    recording = collection.recording(measured)
    q = random_smooth_path(model, np.random.default_rng(77), OTHER_ROWS, box)
    true = session.transmissions[arm].plant.run(q)
    drawn = record_motion(session, arm, np.random.default_rng(seed), box)
    error = (recording.q_phy - collection.q_joint)[recording.valid]
    return {
        "image_ms": image_ms,
        "good": float(recording.valid.sum() / rows),
        "sphere_distance_rms_mm": 1e3 * measured.distance_rms_m,
        "joint_rms": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "images": {part: wrist_rmse(recording, part, q, true) for part in PARTS if part <= rows + 2},
        "drawn": {part: wrist_rmse(drawn, part, q, true) for part in PARTS if part <= rows + 2},
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1355)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {arm: measure(arm, options.rows, options.seed) for arm in ("psm1", "psm2")}
    if options.json:
        print(json.dumps(found))
        return
    for arm, figures in found.items():
        joints = " ".join(f"{value:.4f}" for value in figures["joint_rms"][3:])
        print(
            f"{arm}: {figures['image_ms']:.0f} ms an image, {100 * figures['good']:.0f} % good, distances "
            f"{figures['sphere_distance_rms_mm']:.2f} mm RMS, measured - true q4 q5 q6 {joints} rad RMS"
        )
        print("  rows   play on images, q4 q5 q6 [rad RMSE]   on drawn joints")
        for part, values in figures["images"].items():
            both = ["  ".join(f"{value:.4f}" for value in row) for row in (values, figures["drawn"][part])]
            print(f"  {part:4d}   {both[0]:36s}   {both[1]}")


if __name__ == "__main__":
    main()
