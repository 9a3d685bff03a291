"""How often the better direction of a suture changes twice round the circle in random setups, by formula of the margin.

Run: .venv/bin/python benchmarks/bench_suture_setups.py [SEED]
"""

from __future__ import annotations

import sys

import numpy as np

from trocar.geometry import TURN
from trocar.tasks.suture.planning import MARGINS, Reward, SutureJoints, SutureSetup, suture_joints
from trocar.tasks.suture.planning.parameters import SEARCHED, with_parameters
from trocar.tasks.suture.planning.rewards import scored

SETUPS, POSITIONS, COARSE = 300, 180, 12
DRAWN = tuple(name for name in SEARCHED if not name.startswith(("center", "base_sideways", "puller")))
CLEARANCE_M = (0.010, 0.050)
"""How far outside the circle the base stands, seen from above; the paper's arm is mounted beside the phantom."""
REWARDS = {"default": Reward(), **{name: Reward(margin=name, at="stations", feasible_first=False) for name in MARGINS}}
"""The default; each margin formula at the stations and without regard to limits, as in the paper."""


def random_setup(rng: np.random.Generator) -> SutureSetup:
    """Return a setup whose parameters are drawn uniformly from their usual bounds."""
    values = {name: float(rng.uniform(*SEARCHED[name])) for name in DRAWN}
    values["base_sideways_m"] = values["circle_radius_m"] + float(rng.uniform(*CLEARANCE_M))
    return with_parameters(SutureSetup(), values)


def feasible_setups(rng: np.random.Generator) -> list[tuple[SutureSetup, SutureJoints]]:
    """Return random setups with at least one feasible direction at every position, and their joints."""
    thetas = np.arange(POSITIONS) * (TURN / POSITIONS)
    found: list[tuple[SutureSetup, SutureJoints]] = []
    while len(found) < SETUPS:
        setup = random_setup(rng)
        for some in (thetas[:: POSITIONS // COARSE], thetas):  # most setups already fail at a few positions
            joints = suture_joints(setup, some)
            if not joints.feasible.any(0).all():
                break
        else:
            found.append((setup, joints))
    return found


def main(seed: int = 0) -> None:
    setups = feasible_setups(np.random.default_rng(seed))
    one_way = [joints.feasible.sum(0) == 1 for _, joints in setups]
    for name, reward in REWARDS.items():
        maps = [scored(setup, reward, joints) for setup, joints in setups]
        twice = np.array([len(map.switches_rad) == 2 for map in maps])
        wrong = np.array([(~map.feasible & where).sum() for map, where in zip(maps, one_way, strict=True)])
        right = wrong == 0
        print(
            f"{name}: two changes {100 * twice.mean():.1f} %, {100 * twice[right].mean():.1f} % of the {right.sum()} "
            f"setups without a wrong choice; wrong {100 * wrong.sum() / sum(map(sum, one_way)):.1f} %"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
