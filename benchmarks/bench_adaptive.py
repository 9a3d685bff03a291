"""Errors of wrists over a block for arms that learn their cables, and whether the stated uncertainty is right.

    trocar run peg-transfer --method adaptive --sessions 12 --seed 20261304 --out out/adaptive
    python benchmarks/bench_adaptive.py out/adaptive

For each look over a block in the saved trials of such a run, the wrist's true joints are compared with those that the
arm believed before the look and after its correction. Nothing is timed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from trocar.arms import fk
from trocar.eval.trial import Trial
from trocar.lab import load_station

LATER_S = 0.06
"""This long after the look was evaluated, the correction holds and the arm still rests."""


def rows_of(trial: Trial) -> list[tuple[np.ndarray, ...]]:
    """Return for each look wrist errors before and after (3,), stated SDs (3,), tip errors before and after in mm."""
    rows, scenery, station = [], trial.scenery, load_station(trial.about["station"])
    for event in trial.events:
        if event["name"] != "wrist seen" or event["spread_rad"] is None:
            continue
        arm, errors, tips = event["arm"], [], []
        for at_s in (event["time_s"] - 2 * scenery.tick_s, event["time_s"] + LATER_S):
            at = round(at_s / scenery.tick_s)
            true, asked = (trial.arrays[f"{kind}_{arm}"][at, :6].astype(float) for kind in ("true", "desired"))
            errors.append((true - asked)[3:])
            here = scenery.T_world_base[arm] @ fk(scenery.arms[arm], true)
            believed = scenery.T_world_base_registered[arm] @ fk(station.arm(arm).model, asked)
            tips.append(1e3 * float(np.linalg.norm(here.translation_m - believed.translation_m)))
        rows.append((*errors, np.array(event["spread_rad"]), *tips))
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="of a run with --method adaptive; none: no output")
    folder = parser.parse_args().folder
    if folder is None:
        return
    files = sorted(folder.rglob("trial_*.npz"))
    trials = [Trial.load(file) for file in files]
    rows = [row for trial in trials for row in rows_of(trial)]
    if not rows:
        raise SystemExit("no look at a wrist is in there: give the folder of a run with --method adaptive")
    before, after, said, tip_before, tip_after = (np.array(column) for column in zip(*rows, strict=True))
    inside = np.abs(before) < 1.96 * said

    def rms(values: np.ndarray) -> str:
        return " ".join(f"{value:.3f}" for value in np.sqrt(np.mean(values**2, axis=0)))

    later = [score["succeeded"] for trial in trials for score in trial.scores[1:]]
    if later:
        print(f"from the second transfer on: {sum(later)} of {len(later)}, {100 * np.mean(later):.1f} %")
    noted = [[event for event in trial.events if event["name"] == "transfer"] for trial in trials]
    firsts = [events[0]["start_s"] for events in noted if events]
    took = [event["time_s"] - event["start_s"] for events in noted for event in events]
    print(f"first transfer begins after {np.mean(firsts):.1f} s; {np.mean(took):.2f} s a transfer from then on")
    print(f"{len(rows)} looks over a block in {len(files)} trials; q4 q5 q6")
    print(f"| RMS error of the wrist before the look, rad | {rms(before)} |")
    print(f"| and after its correction, rad | {rms(after)} |")
    print(f"| inside the stated 95 % interval | {100 * inside.mean():.1f} % of joints |")
    for name, tip in (("before", tip_before), ("after", tip_after)):
        print(
            f"| tip {name}, RMS; 95th percentile, mm | {np.sqrt(np.mean(tip**2)):.2f}; {np.percentile(tip, 95):.2f} |"
        )


if __name__ == "__main__":
    main()
