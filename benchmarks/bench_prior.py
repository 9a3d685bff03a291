"""RMSE of cable models fitted to the first rows of real recordings, with and without a prior over instruments.

    python benchmarks/bench_prior.py [--data DIR]

The prior is learned from the recordings of all other instruments; for another session of a known instrument, from all
other recordings. The last table compares the errors of a fit with the SDs that it states. Nothing here is timed, so
every machine prints the same figures.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from trocar.calibration.fleet import FleetPrior, fit_from_prior, learn_from, learn_prior
from trocar.calibration.models.play import PlayModel
from trocar.calibration.plant import play_operator
from trocar.calibration.recording import Recording, load_recording

INSTRUMENTS = {
    "psm1_grey_random": "grey 1",
    "psm1_grey_pick_place": "grey 1",
    "psm1_grey_user_random": "grey 1",
    "psm1_red_user_random": "red",
    "psm2_grey_random": "grey 2",
    "psm1_new_random": "new",
}
ROWS = (50, 100, 200)
TARGETS = {
    "psm1_grey_random": (".021 .038 .032", ".016 .036 .026", ".013 .029 .021", ".008 .021 .016"),
    "psm2_grey_random": (".013 .034 .028", ".013 .030 .025", ".013 .022 .021", ".008 .016 .013"),
    "psm1_new_random": (".020 .040 .030", ".016 .020 .016", ".014 .015 .015", ".011 .010 .011"),
}
SESSIONS = {"psm1_grey_pick_place": (75, ".021 .024 .020"), "psm1_grey_user_random": (300, ".019 .055 .056")}
TRAINING_SHARE = 0.8


def rmse(model: PlayModel, recording: Recording, first: int) -> str:
    """Return the RMSE of q4 q5 q6 from row ``first`` on, as text."""
    error = (model.predict(recording.q_cmd) - recording.q_phy)[first:][recording.valid[first:]]
    return " ".join(f"{value:.3f}"[1:] for value in np.sqrt(np.mean(error[:, 3:] ** 2, axis=0)))


def row(title: str, recording: Recording, rows: int, tail: int, prior: FleetPrior, target: str) -> tuple[str, int]:
    """Return a line of the table, with errors from row ``tail`` on, and how many of the three miss their targets."""
    part = recording.first(rows)
    with_prior = rmse(fit_from_prior(part, prior), recording, tail)
    without = rmse(PlayModel.fit(part, np.random.default_rng(0)), recording, tail)
    missed = sum(float(value) > float(most) for value, most in zip(with_prior.split(), target.split(), strict=True))
    return f"| {title} | {with_prior} | {without} | {target} |", missed


def over_said(recording: Recording, rows: int, prior: FleetPrior) -> np.ndarray:
    """Return the RMS (3,) of the wrist's errors after the first rows, divided by the SDs that a fit to these states."""
    learned, q = learn_from(recording.first(rows), prior), recording.q_cmd
    states = play_operator(learned.model.inputs(q)[:, :, None], learned.model.radii)
    said = np.array([learned.spread(state, command) for state, command in zip(states, q, strict=True)])
    later = recording.valid & (np.arange(len(q)) >= rows)
    return np.sqrt(np.mean(((learned.model.predict(q) - recording.q_phy)[:, 3:] / said)[later] ** 2, axis=0))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).parents[2] / "shared/data/dvrk/trajectories"
    parser.add_argument("--data", type=Path, default=default)
    folder = parser.parse_args().data
    if not folder.is_dir():
        raise SystemExit(f"{folder} is not there: give the folder of the recordings with --data")
    data = {name: load_recording(folder / f"{name}.npz") for name in INSTRUMENTS}
    print("| recording | rows | from the prior | without | target |\n|---|---|---|---|---|")
    missed = 0
    for name, targets in TARGETS.items():
        prior = learn_prior([data[other] for other, which in INSTRUMENTS.items() if which != INSTRUMENTS[name]])
        cut = int(TRAINING_SHARE * len(data[name]))
        for rows, target in zip((*ROWS, cut), targets, strict=True):
            line, misses = row(f"`{name}` | {rows}", data[name], rows, cut, prior, target)
            print(line, flush=True)
            missed += misses
    for name, (rows, target) in SESSIONS.items():
        prior = learn_prior([data[other] for other in INSTRUMENTS if other != name])
        last = int(np.flatnonzero(data[name].valid)[rows - 1]) + 1
        line, misses = row(f"`{name}`, another session | {rows}", data[name], last, last, prior, target)
        print(line, flush=True)
        missed += misses
    print(f"\n{missed} of {3 * (4 * len(TARGETS) + len(SESSIONS))} figures miss their targets")
    print("\n| recording | rows | errors of q4 q5 q6 over the SDs that the fit says |\n|---|---|---|")
    ratios = []
    for name, which in INSTRUMENTS.items():
        prior = learn_prior([data[other] for other, its in INSTRUMENTS.items() if its != which])
        for rows in ROWS[:2]:
            ratios.append(over_said(data[name], rows, prior))
            print(f"| `{name}` | {rows} | {' '.join(f'{ratio:.2f}' for ratio in ratios[-1])} |", flush=True)
    print(f"| median | | {' '.join(f'{ratio:.2f}' for ratio in np.median(ratios, axis=0))} |")


if __name__ == "__main__":
    main()
