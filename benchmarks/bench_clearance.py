"""Success of the paper's network and of no calibration, over the thickness of the fingers and the arms' stiffness.

    python benchmarks/bench_clearance.py --sessions 6 --out out/clearance

In the default cell, ``lstm`` (the network of Hwang et al. 2022) loses more blocks than in the paper, where it had 120
of 120, and 26 of 75 without calibration. Neither the shape of the fingers nor how far an arm yields is known for the
paper's robot, and the width of its pegs is given as 2.25 mm in the text and seen as 3.5 mm in the photographs. This
plays one trial with one arm in each of the sessions at each point of a grid of the first two, and one with thin pegs.
The interval of each rate (95 %) counts sessions. Points are kept in the folder; the same command continues.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

FINGERS_MM, STIFFNESS = (0.6, 0.8, 1.0), (1 / 3, 1.0, 3.0)
PEG_MM = 3.5
METHODS = {"lstm": ("calibrated", "lstm"), "uncalibrated": ("uncalibrated", "")}


class Point(NamedTuple):
    """A cell: thickness of a finger near its end, stiffness over that of the default cell, diameter of the pegs."""

    finger_mm: float
    stiffness: float
    peg_mm: float

    @property
    def name(self) -> str:
        """Return it as a file's name."""
        return f"finger_{self.finger_mm:g}_stiffness_{self.stiffness:.2g}_peg_{self.peg_mm:g}"


POINTS = [*(Point(*point, PEG_MM) for point in product(FINGERS_MM, STIFFNESS)), Point(1.0, 1.0, 2.25)]


def change_cell(point: Point) -> None:
    """Change arms and pegs in this process, for the cell and for what its agents know of it."""
    from dataclasses import replace

    from trocar.arms import LARGE_NEEDLE_DRIVER
    from trocar.sim import spec, world
    from trocar.tasks.peg_transfer.shapes import Pegboard

    object.__setattr__(LARGE_NEEDLE_DRIVER, "finger_tip_m", 1e-3 * point.finger_mm)
    stiffness = tuple(point.stiffness * one for one in spec.SERVO.stiffness)
    spec.SERVO = world.SERVO = replace(spec.SERVO, stiffness=stiffness)
    assert Pegboard.__init__.__defaults__ is not None
    Pegboard.__init__.__defaults__ = (1e-3 * point.peg_mm / 2, *Pegboard.__init__.__defaults__[1:])
    assert Pegboard().peg_radius_m == 1e-3 * point.peg_mm / 2


def play(point: Point, session: int, sessions: int, seed: int, folder: Path) -> dict[str, list[int]]:
    """Play a session's trials at a point; return of each method: transfers done, and those available."""
    from trocar.eval.config import RunConfig
    from trocar.eval.prepare import CACHE, prepare
    from trocar.eval.run import run_trial
    from trocar.tasks.peg_transfer.task import PegTransfer

    # arms that yield more have other recordings; the cache knows nothing of that
    os.environ[CACHE] = str(folder / f"models_{point.stiffness:.2g}")
    change_cell(point)
    counts = {}
    for name, (method, model) in METHODS.items():
        config = RunConfig(PegTransfer(), method=method, model=model, sessions=sessions, seed=seed)
        trial = run_trial(config, prepare(config, session, folder / point.name / name), 0)
        counts[name] = [sum(bool(score[key]) for score in trial.scores) for key in ("succeeded", "available")]
    return counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=6)
    parser.add_argument("--seed", type=int, default=20261305)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, help="folder of the points; none: no output")
    given = parser.parse_args()
    if given.out is None:
        return
    from trocar.eval.statistics import session_interval

    given.out.mkdir(parents=True, exist_ok=True)
    print("| fingers | stiffness | pegs | the paper's network | uncalibrated |\n|---|---|---|---|---|")
    for point in POINTS:
        path = given.out / f"{point.name}_{given.seed}.json"
        kept = json.loads(path.read_text()) if path.is_file() else []
        todo = range(len(kept), given.sessions)
        how = {"max_workers": given.jobs, "mp_context": get_context("spawn"), "max_tasks_per_child": 1}
        with ProcessPoolExecutor(**how) as pool:
            orders = [pool.submit(play, point, one, given.sessions, given.seed, given.out) for one in todo]
            for order in orders:
                kept.append(order.result())
                path.write_text(json.dumps(kept))
                print(f"{point.name}: {len(kept)} of {given.sessions} sessions", file=sys.stderr)
        cells = []
        for name in METHODS:
            done, there = ([one[name][k] for one in kept[: given.sessions]] for k in (0, 1))
            low, high = session_interval(done, there)
            cells.append(f"{sum(done)} of {sum(there)} ({100 * low:.0f} to {100 * high:.0f} %)")
        print(
            f"| {point.finger_mm:g} mm | x {point.stiffness:.2g} | {point.peg_mm:g} mm | {' | '.join(cells)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
