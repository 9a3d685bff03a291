"""Time to find the needle in the image of a look, beside the budget that the agent declares for it.

    python benchmarks/bench_needle_looks.py [--seed N]

Runs one session of four driven sutures (`trocar run suture --seed N`, a minute or two), then times the computation of
each look by itself, the best of three, on one core. Times depend on the machine, so its speed relative to that for
which budgets are declared is printed too.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from unittest.mock import patch

import numpy as np

import trocar
from trocar.counting import counted
from trocar.log import machine_speed
from trocar.tasks.suture import perception
from trocar.tasks.suture.agents import needle_tracker
from trocar.tasks.suture.agents.circle import Settings
from trocar.tasks.suture.perception import search_starts, sight_needle


def best_s(look: partial) -> float:
    """Return the processor time of a computation, s."""
    times = []
    for _ in range(3):
        start_s = time.process_time()
        look()
        times.append(time.process_time() - start_s)
    return min(times)


def main(seed: int) -> None:
    looks: list[partial] = []

    def noted(*args: object) -> perception.NeedleSighting | None:
        looks.append(partial(sight_needle, *args))
        return looks[-1]()

    with patch.object(needle_tracker, "sight_needle", noted):
        trocar.run("suture", sessions=1, trials=1, seed=seed, calibration="joints")
    starts = [len(search_starts(*look.args[1:4])) for look in looks]
    print(f"machine: {machine_speed():.2f} times as fast as the one for which times are declared")
    declared = Settings()
    for count in sorted(set(starts)):
        times_ms = 1e3 * np.array([best_s(look) for look, of in zip(looks, starts, strict=True) if of == count])
        median, most = np.percentile(times_ms, [50, 95])
        budget_ms = 1e3 * (declared.sighting_budget_s + (count - 1) * declared.start_budget_s)
        print(
            f"searched for from {counted(count, 'pose')}: {counted(len(times_ms), 'look')}, median {median:.0f}, "
            f"p95 {most:.0f} ms; declared {budget_ms:.0f} ms"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    main(parser.parse_args().seed)
