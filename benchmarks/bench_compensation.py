"""Time of one command compensation for every cable model, on a recording made by the identified plant."""

import argparse
import json
import time

import numpy as np

from trocar.arms import PSM_CLASSIC
from trocar.calibration.compensation import Compensator
from trocar.calibration.excitation import random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording


def main() -> None:
    """Print one line per model: fit time, median and p95 of a compensation, true error left in the plant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    q = random_smooth_path(PSM_CLASSIC, rng)
    recording = Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(len(q), bool), 0.8 * np.arange(len(q)))
    desired = random_smooth_path(PSM_CLASSIC, rng, 300)
    results = {}
    for name, kind in MODELS.items():
        start = time.perf_counter()
        model = kind.fit(recording, rng)
        fit_s = time.perf_counter() - start
        compensator = Compensator(model)
        compensator.start(desired[0])
        q_cmd, times_ms = [desired[0]], []
        for row in desired:
            start = time.perf_counter()
            q_cmd.append(compensator.path(row[None])[0])
            times_ms.append(1e3 * (time.perf_counter() - start))
        error = (PSM1_GREY.run(np.array(q_cmd))[1:] - desired)[20:, 3:]
        noise = PSM1_GREY.noise_sd[3:]
        results[name] = {
            "method": compensator.method,
            "fit_s": fit_s,
            "median_ms": float(np.median(times_ms)),
            "p95_ms": float(np.quantile(times_ms, 0.95)),
            "rmse_rad": np.sqrt(np.mean(error**2, axis=0)).tolist(),
            "rmse_measured_rad": np.sqrt(np.mean(error**2, axis=0) + noise**2).tolist(),
        }
    if arguments.json:
        print(json.dumps(results))
        return
    for name, row in results.items():
        rmse = " ".join(f"{value:.4f}" for value in row["rmse_rad"])
        print(
            f"{name:7s} {row['method']:10s} fit {row['fit_s']:5.1f} s, one point {row['median_ms']:.3f} ms "
            f"(p95 {row['p95_ms']:.3f}), RMSE q4 q5 q6 {rmse} rad"
        )


if __name__ == "__main__":
    main()
