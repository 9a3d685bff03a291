"""Errors of a real gripper's pose predicted 1, 2 and 5 s after its last detection, beside the noise of detections.

Run: .venv/bin/python benchmarks/bench_gripper_pose.py [--pairs FILE] [--seed N] [--choice] [--sensitivity] [--json]
"""

import argparse
import json
import os
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from error_filter import ErrorFilter, FilterSettings
from gripper_pose import (
    HORIZONS_S,
    HeldError,
    PapersRule,
    RawKinematics,
    Summary,
    detection_noise,
    prediction_errors,
    ratio_of_means,
    read_pairs,
    replay,
)
from scipy.stats import chi2

DATA = Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))
ESTIMATORS = {
    "raw kinematics": RawKinematics,
    "paper's rule": PapersRule,
    "held error": HeldError,
    "error filter": ErrorFilter,
}
COMPARED = (
    ("paper's rule", "raw kinematics"),
    ("error filter", "raw kinematics"),
    ("held error", "paper's rule"),
    ("error filter", "paper's rule"),
)
QUANTITIES = {"translation": "translation_m", "rotation": "rotation_rad"}
CHOICE = {"drift_s": (2.0, 5.0, 10.0), "lag_s": (0.5, 1.0, 2.0), "drift_m": (0.002, 0.0035, 0.006)}
"""Values among which forward chaining chooses, for the physical settings that no datasheet gives."""
WARM_UP = 20
"""Pairs before the first choice."""


def errors_by_name(pairs):
    """Return {(estimator, horizon in s): errors}."""
    return {(name, h): prediction_errors(make, pairs, h) for name, make in ESTIMATORS.items() for h in HORIZONS_S}


def table(errors):
    """Return one row per estimator and horizon: mean, RMS, p95 in mm, then in deg."""
    rows = []
    for (name, horizon_s), found in errors.items():
        shift, turn = Summary.of(1e3 * found.translation_m), Summary.of(np.degrees(found.rotation_rad))
        rows.append(
            dict(
                estimator=name,
                horizon_s=horizon_s,
                targets=len(found.targets),
                mean_age_s=float(found.ages_s.mean()),
                translation_mm=vars(shift),
                rotation_deg=vars(turn),
            )
        )
    return rows


def ratios(errors, rng):
    """Return the ratios of mean errors with their 95 % intervals."""
    rows = []
    for (name, reference), horizon_s in product(COMPARED, HORIZONS_S):
        ours, theirs = errors[name, horizon_s], errors[reference, horizon_s]
        row = dict(estimator=name, reference=reference, horizon_s=horizon_s)
        for name_of, field in QUANTITIES.items():
            row[name_of] = vars(ratio_of_means(getattr(ours, field), getattr(theirs, field), rng))
        rows.append(row)
    return rows


def coverage(pairs, horizon_s):
    """Return the shares of detected positions and orientations inside the filter's 95 % regions, its noise included."""
    inside = []
    for k, _, estimator in replay(ErrorFilter, pairs, horizon_s):
        belief = estimator.belief(pairs.times_s[k], pairs.T_base_kinematic[k])
        seen, T = pairs.T_base_detected[k], belief.T_base_gripper
        turn = (seen.rotation @ T.rotation.inverse()).log()
        covariance = belief.covariance + belief.detection_noise
        halves = ((seen.translation_m - T.translation_m, slice(0, 3)), (turn, slice(3, 6)))
        inside.append([e @ np.linalg.solve(covariance[s, s], e) <= chi2.ppf(0.95, 3) for e, s in halves])
    return np.mean(inside, axis=0).tolist()


def chosen_ahead(pairs, horizon_s):
    """Return the mean error in m with settings chosen from the past, that of the default settings, and the last choice.

    A target's settings are those that did best on the targets up to its last detection.
    """
    grid = [dict(zip(CHOICE, values, strict=True)) for values in product(*CHOICE.values())]
    settings = [replace(FilterSettings(), **values) for values in grid]
    found = [prediction_errors(partial(ErrorFilter, s), pairs, horizon_s) for s in settings]
    shift_m, times_s = np.array([f.translation_m for f in found]), pairs.times_s[found[0].targets]
    mean, picked = [], []
    for i in range(WARM_UP, shift_m.shape[1]):
        best = int(np.argmin(shift_m[:, times_s <= times_s[i] - horizon_s].mean(1)))
        mean.append(shift_m[best, i])
        picked.append(settings[best])
    default = shift_m[settings.index(FilterSettings()), WARM_UP:]
    return float(np.mean(mean)), float(default.mean()), picked[-1]


def sensitivity(pairs):
    """Return {setting: mean errors in mm and deg at 1 s with half and with twice its value}."""
    rows = {}
    for name, value in vars(FilterSettings()).items():
        found = [
            prediction_errors(partial(ErrorFilter, replace(FilterSettings(), **{name: factor * value})), pairs, 1.0)
            for factor in (0.5, 2)
        ]
        rows[name] = [(1e3 * f.translation_m.mean(), np.degrees(f.rotation_rad.mean())) for f in found]
    return rows


def show(result):
    print(f"{'':16} horizon  targets  mean age   translation, mm         rotation, deg")
    print(f"{'':16}                              mean    RMS    p95     mean    RMS    p95")
    for row in result["errors"]:
        numbers = [*row["translation_mm"].values(), *row["rotation_deg"].values()]
        cells = "".join(f"{n:7.1f}{'  ' if i == 2 else ''}" for i, n in enumerate(numbers))
        print(f"{row['estimator']:16} {row['horizon_s']:5.0f} s {row['targets']:8} {row['mean_age_s']:7.1f} s {cells}")
    print("\nRatio of mean errors with the 95 % interval of a moving-blocks bootstrap")
    for row in result["ratios"]:
        pair = f"{row['estimator']} / {row['reference']}"
        cells = ["{value:.2f} ({low:.2f}-{high:.2f})".format(**row[what]) for what in ("translation", "rotation")]
        print(f"{pair:32} {row['horizon_s']:3.0f} s   translation {cells[0]}   rotation {cells[1]}")
    sd_mm, axis = result["noise_sd_mm"], result["noise_axis"]
    print(
        f"\nNoise of a detection from image to image: {sd_mm[2]:.1f} mm along ({', '.join(f'{a:.2f}' for a in axis)}), "
        f"{sd_mm[0]:.1f} and {sd_mm[1]:.1f} mm across;\n"
        f"with that alone an estimator would err {np.hypot.reduce(sd_mm):.1f} mm RMS"
    )
    for horizon_s, (position, orientation) in result["coverage"].items():
        print(
            f"Inside the filter's 95 % regions at {horizon_s:.0f} s: "
            f"{position:.0%} of positions, {orientation:.0%} of orientations"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=Path, default=DATA / "raven" / "gripper_pose_pairs.csv")
    parser.add_argument("--seed", type=int, default=1, help="of the bootstrap")
    parser.add_argument("--choice", action="store_true", help="also choose settings by forward chaining (20 s)")
    parser.add_argument("--sensitivity", action="store_true", help="also halve and double each setting (20 s)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    pairs = read_pairs(args.pairs)
    if pairs.note:
        print(pairs.note)
    errors = errors_by_name(pairs)
    variances, axes = np.linalg.eigh(detection_noise(pairs))
    result = dict(
        errors=table(errors),
        ratios=ratios(errors, np.random.default_rng(args.seed)),
        noise_sd_mm=(1e3 * np.sqrt(variances)).tolist(),
        noise_axis=(axes[:, -1] * np.sign(axes[1, -1])).tolist(),
        coverage={h: coverage(pairs, h) for h in HORIZONS_S},
    )
    if args.json:
        print(json.dumps(result))
    else:
        show(result)
    if args.choice:
        ahead, default, last = chosen_ahead(pairs, 1.0)
        choice = ", ".join(f"{name} {getattr(last, name):g}" for name in CHOICE)
        print(f"\nSettings chosen by forward chaining: {1e3 * ahead:.2f} mm at 1 s over the last targets;", end=" ")
        print(f"the default there {1e3 * default:.2f} mm; last choice: {choice}")
    if args.sensitivity:
        print("\nMean error at 1 s with half and with twice a setting")
        for name, ((low_mm, low_deg), (high_mm, high_deg)) in sensitivity(pairs).items():
            print(f"{name:14} {low_mm:5.2f} {high_mm:5.2f} mm   {low_deg:5.2f} {high_deg:5.2f} deg")


if __name__ == "__main__":
    main()
