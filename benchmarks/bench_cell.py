"""Is the simulated cell as hard as a laboratory? The same statistics of real recordings and of the cell.

    python benchmarks/bench_cell.py [--difficulty recorded] [--sessions 10] [--data DIR]

Cables: the recorded commands are played through the cell's cables in several sessions, and the play model is fitted to
both. Its residuals, their autocorrelation, and its errors on the last fifth when fitted to the rest are printed.
Sessions: mean and spread of the parameters identified in three sessions of one instrument, and tip errors without
compensation in one of them, real and in the cell. Registration: residuals of a rigid fit, and errors of a fit to one
half of the points at the other half. Nothing is timed: every machine prints the same figures.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.arms import PSM_CLASSIC, fk
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import fit_plant
from trocar.calibration.recording import Recording, load_recording
from trocar.geometry.rigid_fit import fit_rigid
from trocar.lab import TRANSMISSIONS, Registration, load_station
from trocar.lab.flaws import LEVELS, RECORDED, Difficulty
from trocar.lab.session import points_of_registration
from trocar.lab.transmission import Cables, DriveTrain

INSTRUMENTS = {"psm1_grey_random": "psm1_grey", "psm2_grey_random": "psm2_grey", "psm1_new_random": "psm1_new"}
SESSIONS = ("psm1_grey_random", "psm1_grey_pick_place", "psm1_grey_user_random")
SETS = ("set_1", "set_2", "script")
LAGS = (1, 10, 100)
TRAINING_SHARE = 0.8
UNITS = 1e3
"""Everything is printed in mrad and mm."""


def of_cables(plant: str) -> Cables:
    """Return the cables of an identified instrument."""
    found = TRANSMISSIONS[plant]
    assert isinstance(found, Cables)
    return found


def in_the_cell(recording: Recording, transmission: Cables, difficulty: Difficulty, seed: int) -> Recording:
    """Return the recording with the joints of the cell's cables under the same commands."""
    rng = np.random.default_rng([seed, len(recording)])
    drawn = transmission.drawn(rng, difficulty)
    train = DriveTrain(drawn, recording.q_cmd[0], rng)
    joints = []
    for q, dt_s in zip(recording.q_cmd, np.diff(recording.t_s, prepend=recording.t_s[0]), strict=True):
        train.advance(float(dt_s))
        joints.append(train.joints(q))
    noise = drawn.measurement_sd * rng.standard_normal(recording.q_cmd.shape)
    return replace(recording, q_phy=np.array(joints) + noise)


def left(recording: Recording) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the play model's residuals: SD (6,), autocorrelations (lags, 6), and RMS (6,) on the unseen last fifth."""
    rng, valid = np.random.default_rng(0), recording.valid
    rest = recording.q_phy - PlayModel.fit(recording, rng).predict(recording.q_cmd)
    sd = rest[valid].std(axis=0)
    pairs = [(rest[:-lag][valid[:-lag] & valid[lag:]], rest[lag:][valid[:-lag] & valid[lag:]]) for lag in LAGS]
    correlation = np.array([(a * b).mean(axis=0) / sd**2 for a, b in pairs])
    cut = int(TRAINING_SHARE * len(recording))
    error = (PlayModel.fit(recording.first(cut), rng).predict(recording.q_cmd) - recording.q_phy)[cut:][valid[cut:]]
    return sd, correlation, np.sqrt(np.mean(error**2, axis=0))


def cables(data: Path, difficulty: Difficulty, sessions: int) -> None:
    """Print the residuals of the play model, in recordings and in the cell."""
    print("| recording | | left, mrad mm | on the last fifth | correlation after 1, 10, 100 samples, q5 |")
    print("|---|---|---|---|---|")
    for name, plant in INSTRUMENTS.items():
        real = load_recording(data / f"{name}.npz")
        cell = [left(in_the_cell(real, of_cables(plant), difficulty, seed)) for seed in range(sessions)]
        ours = tuple(np.mean([found[k] for found in cell], axis=0) for k in range(3))
        for where, (sd, correlation, tail) in (("recorded", left(real)), ("in the cell", ours)):
            along = " ".join(f"{value:.2f}" for value in correlation[:, 4])
            print(f"| `{name}` | {where} | {row(sd)} | {row(tail)} | {along} |", flush=True)


def row(values: NDArray[np.float64]) -> str:
    """Return six errors in mrad and mm."""
    return " ".join(
        f"{UNITS * value:.2f}" if number < 3 else f"{UNITS * value:.0f}" for number, value in enumerate(values)
    )


def spread(data: Path) -> None:
    """Print how much the identified parameters of one instrument differ from session to session."""
    plants = [fit_plant(load_recording(data / f"{name}.npz")) for name in SESSIONS]

    def sd(values: Sequence[object]) -> NDArray[np.float64]:
        return np.std(np.array(values, dtype=np.float64), axis=0, ddof=1)

    print(
        f"\nOne instrument in {len(plants)} sessions, SD: offsets {sd([p.offset for p in plants]).round(3)} rad, ",
        end="",
    )
    print(f"logarithms of radii {rms(sd([np.log(p.radii) for p in plants])):.2f}, ", end="")
    print(f"a {sd([p.a for p in plants]):.3f}, b {sd([p.b for p in plants]):.3f}, ", end="")
    print(f"K {rms(sd([p.K for p in plants])):.3f}, C {rms(sd([p.C for p in plants])):.3f}")
    middle = {name: np.mean([getattr(p, name) for p in plants], axis=0) for name in ("offset", "a", "b", "K", "C")}
    middle["radii"] = np.exp(np.mean([np.log(p.radii) for p in plants], axis=0))
    print("Its mean: " + ", ".join(f"{name} {np.round(value, 3).tolist()}" for name, value in middle.items()))
    missed(data)


def missed(data: Path) -> None:
    """Print the tip errors of an uncompensated pick and place, real and in drawn sessions."""
    real = load_recording(data / "psm1_grey_pick_place.npz")
    places = f"{len(real)} places of `psm1_grey_pick_place`"
    print(f"\nUncompensated tips at the {places}, mm RMS: {miss_mm(real):.1f} recorded", end="")
    recorded = Difficulty.of("recorded")
    usual = of_cables("psm1_grey")
    for what, transmission in (("in the cell", usual), ("about one session", replace(usual, usual=None))):
        drawn = [miss_mm(in_the_cell(real.first(500), transmission, recorded, seed)) for seed in range(40)]
        low, mean, high = np.percentile(drawn, [10, 50, 90])
        print(f", {what} {mean:.1f} ({low:.1f} to {high:.1f} in 80 % of 40 sessions)", end="")
    print()


def miss_mm(recording: Recording) -> float:
    """Return the RMS distance between the tips of measured and of commanded joints, mm."""
    q_cmd, q_phy = recording.q_cmd[recording.valid], recording.q_phy[recording.valid]
    off_m = fk(PSM_CLASSIC, q_phy).translation_m - fk(PSM_CLASSIC, q_cmd).translation_m
    return 1e3 * float(np.sqrt(np.mean(np.sum(off_m**2, axis=-1))))


def rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def registered(p_robot: NDArray[np.float64], p_camera: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return a rigid fit's RMS residual in mm, its correlation between neighbours, and the error at the other half."""
    fit = fit_rigid(p_camera, p_robot).T_target_source
    rest = p_robot - fit.apply(p_camera)
    apart = np.linalg.norm(p_robot[:, None] - p_robot[None], axis=2) + np.diag(np.full(len(p_robot), np.inf))
    neighbour = rest[apart.argmin(axis=1)]
    correlation = float(np.sum(rest * neighbour) / np.sum(rest**2))
    half = p_robot[:, 0] < np.median(p_robot[:, 0])
    off = []
    for known in (half, ~half):
        other = fit_rigid(p_camera[known], p_robot[known]).T_target_source
        off.append(np.linalg.norm(p_robot[~known] - other.apply(p_camera[~known]), axis=1).mean())
    return UNITS * rms(np.linalg.norm(rest, axis=1)), correlation, UNITS * float(np.mean(off))


def registration(data: Path, difficulty: Difficulty, sessions: int) -> None:
    """Print the residuals of rigid fits to recorded sets of points and to those of the cell."""
    print("\n| points | left, mm RMS | correlation of neighbours | off at the other half, mm |\n|---|---|---|---|")
    for name in SETS:
        points = np.load(data / f"{name}.npz")
        print("| `{}` | {:.2f} | {:.2f} | {:.2f} |".format(name, *registered(points["p_robot"], points["p_camera"])))
    station = load_station("peg-transfer")
    how = station.registration
    assert isinstance(how, Registration)
    found = []
    for seed in range(sessions):
        rng = np.random.default_rng([seed, 0])
        arm = station.arm("psm1")
        p_base, seen = points_of_registration(arm, arm.transmission.drawn(rng, difficulty), how, difficulty, rng)
        found.append(registered(p_base, seen))
    print("| in the cell | {:.2f} | {:.2f} | {:.2f} |".format(*np.mean(found, axis=0)))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared/data/dvrk")
    parser.add_argument("--difficulty", choices=LEVELS, default=RECORDED)
    parser.add_argument("--sessions", type=int, default=10)
    given = parser.parse_args()
    if not given.data.is_dir():
        raise SystemExit(f"{given.data} is not there: give the folder of the recordings with --data")
    difficulty = Difficulty.of(given.difficulty)
    cables(given.data / "trajectories", difficulty, given.sessions)
    spread(given.data / "trajectories")
    registration(given.data / "registration", difficulty, given.sessions)


if __name__ == "__main__":
    main()
