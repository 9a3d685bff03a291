"""Errors of models fitted to short recordings, by motion: random and smooth as the paper's, or wide swings.

    python benchmarks/bench_excitation.py [--sessions 10] [--difficulty recorded]

The cables are simulated, because there are no real recordings of the wide motion. A model is fitted to 35 to 100
samples, from a prior that never saw the instrument, and compared with the true joints on 300 samples of another smooth
motion. Nothing is timed, so every machine prints the same figures.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from trocar.arms import PSM_CLASSIC
from trocar.calibration.excitation import PSM1_BOX, PSM2_BOX, MotionBox, random_smooth_path, slack_taken_up, wide_path
from trocar.calibration.fleet import FleetPrior, fit_from_prior, load_prior
from trocar.calibration.recording import Recording
from trocar.lab import TRANSMISSIONS, Transmission
from trocar.lab.flaws import LEVELS, RECORDED, Difficulty
from trocar.lab.transmission import DriveTrain
from trocar.sim.calibration_cells import SAMPLE_S

PLANTS = {"psm1_grey": PSM1_BOX, "psm2_grey": PSM2_BOX, "psm1_new": PSM1_BOX}
ROWS = (35, 50, 75, 100)
SCORED = 300
SMOOTH, WIDE = "smooth", "wide"


def recorded(
    transmission: Transmission, path: NDArray[np.float64], rng: np.random.Generator
) -> tuple[Recording, NDArray[np.float64]]:
    """Return a recording along a path, after a swing that takes up the slack, and the true joints."""
    q_cmd = slack_taken_up(PSM_CLASSIC, path)
    train = DriveTrain(transmission, q_cmd[0], rng)
    joints = []
    for q in q_cmd:
        train.advance(SAMPLE_S)
        joints.append(train.joints(q))
    measured = np.array(joints) + transmission.measurement_sd * rng.standard_normal(q_cmd.shape)
    rows = np.arange(len(q_cmd))
    return Recording(q_cmd, measured, rows >= len(q_cmd) - len(path), SAMPLE_S * (rows + 1.0), "simulated"), np.array(
        joints
    )


def errors(plant: str, box: MotionBox, prior: FleetPrior, difficulty: Difficulty, session: int) -> NDArray[np.float64]:
    """Return mean square errors (motions, rows, 3) of q4 q5 q6 in one session."""
    seeds = np.random.SeedSequence([session, len(plant), ord(plant[3])]).spawn(5)
    drawn, moved, tested, *noises = (np.random.default_rng(seed) for seed in seeds)
    transmission = TRANSMISSIONS[plant].drawn(drawn, difficulty)
    test, joints = recorded(transmission, random_smooth_path(PSM_CLASSIC, tested, SCORED, box), noises[0])
    paths = random_smooth_path(PSM_CLASSIC, moved, max(ROWS), box), None
    found = []
    for path in paths:
        row = []
        for rows in ROWS:
            motion = wide_path(PSM_CLASSIC, rows, box) if path is None else path[:rows]
            recording, _ = recorded(transmission, motion, np.random.default_rng(seeds[-1]))
            off = fit_from_prior(recording, prior).predict(test.q_cmd) - joints
            row.append(np.mean(off[test.valid][:, 3:] ** 2, axis=0))
        found.append(row)
    return np.array(found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--difficulty", choices=LEVELS, default=RECORDED)
    given = parser.parse_args()
    difficulty = Difficulty.of(given.difficulty)
    print("| cables | motion | " + " | ".join(f"{rows} samples, {SAMPLE_S * rows:.0f} s" for rows in ROWS) + " |")
    print("|---|---|" + "---|" * len(ROWS))
    for plant, box in PLANTS.items():
        prior = load_prior("fleet").without(plant)
        found = np.mean([errors(plant, box, prior, difficulty, k) for k in range(given.sessions)], axis=0)
        for motion, row in zip((SMOOTH, WIDE), np.sqrt(found), strict=True):
            cells = " | ".join(" ".join(f"{value:.3f}"[1:] for value in rmse) for rmse in row)
            print(f"| `{plant}` | {motion} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
