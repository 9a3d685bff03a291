"""The emergency stop at random times of trials in which two arms move: how long until all rest, within what limits.

    python benchmarks/bench_emergency.py --times 100

Each time is that of another trial of the peg transfer, with the cell's own cables; a braking joint may use its whole
limit of acceleration, so the time that this takes the fastest joint is printed beside. Nothing is timed.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from trocar.arms import MotionLimits
from trocar.console import Watch
from trocar.eval.config import RunConfig
from trocar.eval.prepare import prepare
from trocar.eval.run import run_trial
from trocar.eval.trial import Trial
from trocar.robots import TICK_S
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.view.wishes import Said, Wish

WHOLE_S = 8.0
"""A time before the end of each of these trials."""
VARIANTS = ("handover", "bilateral")
STILL = 1e-7
"""Change of a joint in a tick (rad, m) that is only the rounding of the trial's arrays."""


def rest_and_brake_s(
    trial: Trial, limits: Mapping[str, MotionLimits], at_s: float, until_s: float = np.inf
) -> tuple[float, float]:
    """Return the time that arms and jaws took to come to rest, and the time that braking takes the fastest joint.

    Args:
        trial: the trial.
        limits: of its arms; braking is as hard as they allow.
        at_s: when the arms were to stop, on the trial's clock.
        until_s: until when they are looked at: they may go on then.
    """
    at, rests_s, brakes_s = round(at_s / TICK_S), [0.0], [0.0]
    for arm, most in limits.items():
        steps = np.abs(np.diff(trial.arrays[f"commanded_{arm}"], axis=0))
        moving = steps[at : round(min(until_s / TICK_S, len(steps)))].max(1, initial=0.0) > STILL
        rests_s.append((np.flatnonzero(moving).max(initial=-1) + 1) * TICK_S)
        brakes_s.append(float((steps[max(0, at - 1), :6] / TICK_S / most.acceleration).max()))
    return max(rests_s), max(brakes_s)


class Pressed(Watch):
    """A console without a page, at which the emergency stop is pressed at a time of the cell's clock."""

    def __init__(self, at_s: float):
        super().__init__(speed=0.0, port=None)
        self._at_s = at_s

    def _hear(self) -> list[Said]:
        due = not self.ended and self.console.now_s >= self._at_s
        return [Said(Wish.EMERGENCY)] if due else []


def stopped(variant: str, at_s: float, folder: Path) -> tuple[Trial, float, float]:
    """Press the emergency stop at a time of a trial.

    Returns:
        The trial, the time in s that its arms took to rest, and the time that their limits make them take.
    """
    config = RunConfig(PegTransfer(variant=variant, transfers=2), method="uncalibrated", seed=3)
    prepared = prepare(config, 0, folder)
    with Pressed(at_s) as watch:
        trial = run_trial(config, prepared, 0, attendant=watch)
    (pressed_s,) = [event["time_s"] for event in trial.events if event["name"] == "person"]
    return trial, *rest_and_brake_s(trial, prepared.session.station.limits, pressed_s)


def main(words: Iterable[str] | None = None) -> None:
    """Print the largest of each figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args(words)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number, at_s in enumerate(np.random.default_rng(given.seed).uniform(0.0, WHOLE_S, given.times)):
            trial, rest_s, brake_s = stopped(VARIANTS[number % len(VARIANTS)], at_s, Path(folder))
            assert trial.ended == "FAULT"
            found.append((rest_s, brake_s, max(max(use) for use in trial.command_limit_use.values())))
    rest_s, brake_s, use = np.array(found).T
    moving = int((rest_s > 0).sum())
    print(f"{len(found)} emergency stops while two arms work, {moving} of them while something moves")
    print(f"at rest after at most {rest_s.max():.2f} s")
    more_s = (rest_s - brake_s).max()
    print(f"braking at the limits takes at most {brake_s.max():.2f} s; it took at most {more_s:.3f} s longer")
    print(f"largest share of a limit in a trial: {use.max():.6f}")


if __name__ == "__main__":
    main()
