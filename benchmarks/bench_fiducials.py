"""Calibration from images: time per image, errors of joints and tip, and how many rows the cable model needs.

Each arm of the peg transfer's station is recorded once. Measured joints are compared with those that would put the tip
in its true place if the base stood where it is registered, before the adjustment (closed form, in the base that these
images give) and after it; constant error and scatter are separate. At difficulty `mild`, `play` is then fitted to some
of the rows and compared with the cables, without their unrepeatable part, on another motion; likewise when fitted to
the closed form's joints, and to as many joints with drawn noise. Times are processor times. Three minutes an arm.

Run: .venv/bin/python benchmarks/bench_fiducials.py [--rows N] [--seed N]
"""

import argparse
import os
import time
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.arms import fk
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.collect.collection import Collection
from trocar.lab import load_station
from trocar.lab.flaws import Difficulty
from trocar.lab.session import draw_session
from trocar.perception.fiducial_joints import joints_from_spheres, joints_of_tips
from trocar.sim.calibration_cells import record_motion

PARTS = {"the first 200": (200, 1), "the first 650": (650, 1), "every second": (1302, 2), "all": (1357, 1)}
"""Rows to which a model is fitted: the number of first rows, and the step between those that are used."""
RECORDED_ROWS = 650
OTHER_ROWS, WASHOUT = 800, 30
"""Rows of the other motion; at its beginning the cables' past is unknown."""


def wrist_rmse(recording, part, q, true):
    first, every = part
    rows = recording.first(min(first, len(recording)))
    rows = replace(rows, valid=rows.valid & (np.arange(len(rows)) % every == 0))
    error = (MODELS["play"].fit(rows, np.random.default_rng(0)).predict(q) - true)[WASHOUT:, 3:]
    return np.sqrt(np.mean(error**2, axis=0)).tolist()


def errors(collection, q):
    """Return mean and SD of the errors of measured joints (n, 6), and the RMS error of the tip, mm."""
    arm, true = collection.view.arm, collection.q_joint
    good = np.isfinite(q).all(axis=1)
    off = (q - true)[good]
    tip = (fk(arm, q[good]).translation_m - fk(arm, true[good]).translation_m) * 1e3
    rms_mm = float(np.sqrt(np.mean(np.sum(tip**2, axis=1))))
    return {"constant": off.mean(axis=0).tolist(), "scatter": off.std(axis=0).tolist(), "tip_rms_mm": rms_mm}


def looked_at(level, arm, rows, seed):
    """Record an arm; return session, collection, recording, the joints of the closed form, and figures of both."""
    station = replace(load_station("peg-transfer"), difficulty=Difficulty.of(level))
    session = draw_session(station, np.random.default_rng([seed, 0]))
    box, seeds = station.arm(arm).calibration, np.random.SeedSequence([seed, 1, list(station.arms).index(arm)])
    collection = Collection(session, arm, box, seeds, rows)
    began = time.process_time()
    centers = collection.run()
    image_ms = 1e3 * (time.process_time() - began) / rows
    began = time.process_time()
    measured = collection.measured(centers)
    seconds = time.process_time() - began
    recording, T_camera_base = collection.recording(measured), measured.shaft.T_target_source
    p_base = T_camera_base.inverse().apply(measured.p_camera_m)
    closed = joints_from_spheres(collection.view.arm, collection.fixture, p_base, collection.q_cmd)
    figures = {
        "image_ms": image_ms,
        "joints_s": seconds,
        "good": float(recording.valid.sum() / rows),
        "sphere_distance_rms_mm": 1e3 * measured.distance_rms_m,
        "before": errors(collection, closed),
        "after": errors(collection, recording.q_phy),
    }
    return session, collection, recording, closed, figures


def measure(arm, rows, seed):
    session, collection, recording, closed, figures = looked_at("mild", arm, rows, seed)
    model, box = collection.view.arm, session.station.arm(arm).calibration
    q = random_smooth_path(model, np.random.default_rng(77), OTHER_ROWS, box)
    cables = session.transmissions[arm].plant.run(q)
    T_found_true = collection.view.T_camera_base.inverse() @ collection.T_camera_base_true
    true = joints_of_tips(model, T_found_true @ fk(session.models[arm], cables), cables)
    kinds = {
        "images": recording,
        "closed": replace(recording, q_phy=closed, valid=np.isfinite(closed).all(axis=1)),
        "drawn": record_motion(session, arm, np.random.default_rng(seed), box),
    }
    parts = {name: part for name, part in PARTS.items() if part[0] <= rows + 2}
    fits = {kind: {name: wrist_rmse(of, part, q, true) for name, part in parts.items()} for kind, of in kinds.items()}
    recorded = looked_at("recorded", arm, min(rows, RECORDED_ROWS), seed)[-1]
    return figures | {"recorded": recorded} | fits


def shown(values):
    return " ".join(f"{value:+.4f}" for value in values[3:])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1355)
    parser.add_argument("--seed", type=int, default=3)
    options = parser.parse_args()
    for arm in ("psm1", "psm2"):
        figures = measure(arm, options.rows, options.seed)
        print(
            f"{arm}: {figures['image_ms']:.0f} ms an image, {100 * figures['good']:.0f} % good, distances "
            f"{figures['sphere_distance_rms_mm']:.2f} mm RMS, joints from centres {figures['joints_s']:.1f} s"
        )
        print("  measured - true q4 q5 q6 [rad]   constant                  scatter                   tip [mm RMS]")
        for level, of in (("mild", figures), ("recorded", figures["recorded"])):
            for when in ("before", "after"):
                parts = of[when]
                both = f"{shown(parts['constant'])}   {shown(parts['scatter'])}"
                print(f"  {level + ', ' + when + ' adjustment':31s}  {both}   {parts['tip_rms_mm']:.3f}")
        print("  play on rows     images, q4 q5 q6 [rad RMSE]   closed form alone         drawn joints")
        for part in figures["images"]:
            each = ["  ".join(f"{value:.4f}" for value in figures[of][part]) for of in ("images", "closed", "drawn")]
            print(f"  {part:15s}  {each[0]:28s}  {each[1]:24s}  {each[2]}")


if __name__ == "__main__":
    main()
