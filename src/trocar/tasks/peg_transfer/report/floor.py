"""How long a transfer would take if only motion took time, and what adds to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trocar.report.parts import parts_of

if TYPE_CHECKING:
    from trocar.eval.trial import Trial

MOTION = "motion"


def motion_floor_s(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the mean time per transfer by part, for the arm that moves most in each trial; the parts add up to it.

    ``motion`` among them is the floor, since that arm can do nothing else meanwhile. Planning, looking and jaw actions
    that overlap with motion cost nothing, and are not counted.

    Args:
        trials: of one run.
    """
    count = sum(len(trial.scores) for trial in trials)
    seconds: dict[str, float] = {MOTION: 0.0}
    for trial in trials:
        arms = [parts_of(trial.spans, arm, trial.duration_s) for arm in trial.about["arms"]]
        for name, part_s in max(arms, key=lambda parts: parts.get(MOTION, 0.0)).items():
            seconds[name] = seconds.get(name, 0.0) + part_s / max(count, 1)
    return seconds


def floor_sentence(seconds: dict[str, float]) -> str:
    """Return this as a sentence: the floor, then the parts that explain the gap, the largest first."""
    gap = sorted(((s, name) for name, s in seconds.items() if name != MOTION and s >= 0.005), reverse=True)
    parts = ", ".join(f"{name} {s:.2f}" for s, name in gap)
    total = sum(seconds.values())
    return (
        f"motion alone (of the arm that moves most) would take {seconds[MOTION]:.2f} s per transfer; the "
        f"{total - seconds[MOTION]:.2f} s above that are {parts}"
    )
