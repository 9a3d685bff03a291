"""Registration by a checkerboard: errors of camera and bases, from simulated images and as sessions draw them.

Each session shows the board by hand in some views, mounts the bracket on each base, and finds lenses, camera and bases
from simulated images. For comparison, two thousand sessions are drawn without images: the station's `sd_mm` and
`sd_deg` are right if both columns agree. A session takes about 30 s of one core.

Run: .venv/bin/python benchmarks/bench_checkerboard.py [--sessions N] [--seed N] [--exact-brackets]
"""

import argparse
import os
import time
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from trocar.collect.checkerboard import register_cell
from trocar.lab import load_station
from trocar.lab.session import draw_session

STATION = "raven-pair"
DRAWN = 2000
"""Sessions drawn without images."""


def through_images(station, sessions, seed):
    """Return rows of errors, errors at the board (k, 6) in mm and deg, reprojection RMS in px, and s per session."""
    rows, at_board, pixels = [], [], []
    began = time.perf_counter()
    for number in range(sessions):
        found = register_cell(station, np.random.SeedSequence([seed, number]))
        rows.append(flat(found.errors()))
        T_board_left = station.registration.T_world_board.inverse() @ station.cameras[found.camera].T_world_camera
        at_board += [(T_board_left @ found.poses[arm].T_left_board).log() for arm in station.arms]
        pixels.append([found.calibration.rms_px, *(pose.rms_px for pose in found.poses.values())])
    scale = np.repeat([1e3, np.degrees(1.0)], 3)
    return rows, np.array(at_board) * scale, np.array(pixels), (time.perf_counter() - began) / sessions


def flat(errors):
    """Return the errors of one session by name."""
    found = {}
    for what in ("camera_to_base", "base_to_base"):
        for arm, off in errors[what].items():
            found |= {f"{what} {arm} [{unit}]": off[unit] for unit in ("mm", "deg")}
    return found | {f"seen place in base {arm} [mm]": off for arm, off in errors["places_mm"].items()}


def drawn(station, sessions, seed):
    """Return rows of errors of sessions that are drawn without images."""
    camera = next(iter(station.cameras))
    first = next(iter(station.arms))
    place = station.registration.T_world_board.translation_m
    rows = []
    for number in range(sessions):
        day = draw_session(station, np.random.default_rng([seed, number]))
        row = {}
        seen, found_seen = day.T_world_camera[camera], day.T_world_camera_registered[camera]
        for arm in station.arms:
            base, found = day.T_world_base[arm], day.T_world_base_registered[arm]
            pairs = {f"camera_to_base {arm}": (seen.inverse() @ base, found_seen.inverse() @ found)}
            if arm != first:
                true_first, found_first = day.T_world_base[first], day.T_world_base_registered[first]
                pairs[f"base_to_base {arm}"] = (true_first.inverse() @ base, found_first.inverse() @ found)
            for what, (true, other) in pairs.items():
                off = true.inverse() @ other
                row[f"{what} [mm]"] = 1e3 * float(np.linalg.norm(off.translation_m))
                row[f"{what} [deg]"] = float(np.degrees(off.rotation.angle()))
            p_camera = seen.inverse().apply(place)
            off_m = (found.inverse() @ found_seen).apply(p_camera) - base.inverse().apply(place)
            row[f"seen place in base {arm} [mm]"] = 1e3 * float(np.linalg.norm(off_m))
        rows.append(row)
    return rows


def spread(rows):
    """Return mean and 95th percentile of each error, by name."""
    names = rows[0]
    values = {name: np.array([row[name] for row in rows]) for name in names}
    return {name: (float(v.mean()), float(np.percentile(v, 95))) for name, v in values.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exact-brackets", action="store_true", help="brackets without an error: images alone")
    options = parser.parse_args()
    station = load_station(STATION)
    if options.exact_brackets:
        how = replace(station.registration, bracket_sd_m=0.0, bracket_sd_rad=0.0)
        station = replace(station, registration=how)
    rows, at_board, pixels, seconds = through_images(station, options.sessions, options.seed)
    seen, without = spread(rows), spread(drawn(station, DRAWN, options.seed))
    sd = np.sqrt(np.mean(at_board**2, axis=0))
    sd_mm, sd_deg = (np.sqrt(np.mean(part**2)) for part in (sd[:3], sd[3:]))
    print(f"{options.sessions} sessions through images, {seconds:.0f} s each; {DRAWN} drawn without: mean (p95)")
    for name, (mean, high) in seen.items():
        print(f"  {name:32s} {mean:6.3f} ({high:6.3f})    {without[name][0]:6.3f} ({without[name][1]:6.3f})")
    axes = " ".join(f"{value:.3f}" for value in sd)
    print(f"reprojection, RMS: lenses {pixels[:, 0].mean():.3f} px, boards {pixels[:, 1:].mean():.3f} px")
    print(f"at the board, RMS an axis: {axes} -> sd_mm {sd_mm:.3f}, sd_deg {sd_deg:.3f}")


if __name__ == "__main__":
    main()
