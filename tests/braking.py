"""How long the arms of a trial went on moving once they were to stop, and how long their limits make them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trocar.arms import MotionLimits
from trocar.eval.trial import Trial
from trocar.robots import TICK_S

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
