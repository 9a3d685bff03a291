"""Motions for calibration recordings: the paper's random smooth path (section IV-A), and a short one of wide swings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trocar.errors import InvalidInput
from trocar.geometry import TURN
from trocar.geometry.arrays import Array, finite

if TYPE_CHECKING:
    from trocar.arms import ArmModel

SAMPLES = 1355  # number of data points in the paper's recording, 18 minutes on the robot
MOST_SAMPLES = 100_000  # maximum number of samples of a path: a day on the robot
HARMONICS = 40
BAND = (0.1, 2.2)
"""Frequencies of a joint's motion relative to its pace. Slow components have large amplitudes and fast ones small,
as in the recordings, where a joint reverses 12 to 13 times in a hundred samples."""
SPREAD = 0.7
"""SD of the normal deviate that is mapped to the range: the recordings dwell in its middle (SD .2 of the range)."""

STRAIGHT = 1e-6
"""A wave that covers less of its range than this is practically straight: a lower pace would not change the path."""

WIDE_ROWS = 75  # samples of a recording of wide swings: a minute
WIDE_CYCLES = (1.0, 2.0, 3.0)
"""How often the outer joints q1 q2 q3 go back and forth in such a recording: slowly, since large moves take time."""

EXERCISE_RAD = (0.35, 0.30, 0.30)
"""Swing of roll, pitch and yaw that takes up all slack: more than twice the widest identified backlash (.128)."""


@dataclass(frozen=True, eq=False)
class MotionBox:
    """Range and speed of a random motion."""

    lower: Array  # (6,) smallest command, rad and m (q3)
    upper: Array  # (6,) largest command
    step: Array  # (6,) mean |dq| from sample to sample

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "step"):
            object.__setattr__(self, name, finite(f"{name} of a motion's box", getattr(self, name), 6))

    def mirrored(self) -> MotionBox:
        """Return the box for the other arm: q1, q4 and q6 change sign."""
        sign = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
        ends = np.stack([sign * self.lower, sign * self.upper])
        return MotionBox(ends.min(axis=0), ends.max(axis=0), self.step)


PSM1_BOX = MotionBox(
    lower=np.array([0.62, -0.25, 0.14, -1.70, -1.15, -1.28]),
    upper=np.array([1.07, 0.26, 0.23, 1.08, 0.96, 0.82]),
    step=np.array([0.0085, 0.0136, 0.0018, 0.083, 0.057, 0.073]),
)
"""Range and mean step of the recording psm1_grey_random."""
PSM2_BOX = PSM1_BOX.mirrored()  # its mirror image; psm2_grey_random fills it, except that roll ends at 1.57


def random_smooth_path(arm: ArmModel, rng: np.random.Generator, n: int = SAMPLES, box: MotionBox = PSM1_BOX) -> Array:
    """Return a random smooth path (n, 6) that wanders through the whole box and reverses often.

    Each joint is a sum of sinusoids of random frequency and phase, mapped to its range by the normal distribution
    function. Its pace is scaled until the mean step is that of the box, or, if n is small, until the joint passes
    through its range once.

    Raises TrocarError: the box leaves the arm's joint limits, or n is below 2 or above ``MOST_SAMPLES``.
    """
    _check(arm, n, box)
    return np.column_stack([_wander(rng, n, *ends) for ends in zip(box.lower, box.upper, box.step, strict=True)])


def wide_path(arm: ArmModel, n: int = WIDE_ROWS, box: MotionBox = PSM1_BOX) -> Array:
    """Return a path (n, 6) that reveals much about the cables in few samples: the wrist swings through its whole range.

    From sample to sample the wrist goes to the next point of a Sobol sequence. Most of these swings are wider than the
    backlash, so each sample shows another place of the hysteresis loops. Along a smooth path a joint reverses only
    every eight samples, and all samples in between show the same side of its loop (``benchmarks/bench_excitation.py``).

    Raises TrocarError: the box leaves the arm's joint limits, or n is below 2 or above ``MOST_SAMPLES``.
    """
    _check(arm, n, box)
    from scipy.stats import qmc  # takes a second to import, and few callers need it

    wrist = qmc.Sobol(3, rng=0).random_base2(int(np.ceil(np.log2(n))))[:n]
    phase = TURN * np.arange(n)[:, None] / n
    outer = 0.5 + 0.5 * np.sin(phase * WIDE_CYCLES)
    return box.lower + (box.upper - box.lower) * np.column_stack([outer, wrist])


def slack_taken_up(arm: ArmModel, path: Array) -> Array:
    """Return commands (2 + n, 6): two that swing the wrist back and forth to take up its slack, then the path."""
    swing = np.append(np.zeros(3), EXERCISE_RAD)
    return np.concatenate([np.clip([path[0] + swing, path[0] - swing], arm.lower, arm.upper), path])


def _check(arm: ArmModel, n: int, box: MotionBox) -> None:
    if not 2 <= n <= MOST_SAMPLES:
        raise InvalidInput("a path", f"cannot have {n} samples", f"ask for 2 to {MOST_SAMPLES}")
    for joint, lower, upper in zip(arm.joints, box.lower, box.upper, strict=True):
        if not joint.lower <= lower < upper <= joint.upper:
            problem = f"of joint {joint.name!r} is not inside [{joint.lower:.4f}, {joint.upper:.4f}]"
            remedy = f"choose a box within the limits of {arm.name}"
            raise InvalidInput(f"the motion's range [{lower:.4f}, {upper:.4f}]", problem, remedy)


def _wander(rng: np.random.Generator, n: int, lower: float, upper: float, step: float) -> Array:
    """Return one joint's path (n,) with this mean step."""
    from scipy.special import ndtr  # as above

    frequency = np.exp(rng.uniform(np.log(BAND[0]), np.log(BAND[1]), HARMONICS))
    phase = rng.uniform(0.0, TURN, HARMONICS)
    amplitude = frequency**-0.75
    amplitude *= SPREAD / np.sqrt(0.5 * np.sum(amplitude**2))
    pace = TURN * step / (upper - lower)
    path = np.full(n, lower)
    for _ in range(20):
        wave = ndtr(np.sin(pace * frequency * np.arange(n)[:, None] + phase) @ amplitude)
        if np.ptp(wave) < STRAIGHT:
            break
        path = lower + (upper - lower) * (wave - wave.min()) / np.ptp(wave)
        mean_step = np.abs(np.diff(path)).mean()
        if abs(mean_step - step) < 1e-3 * step:
            break
        pace *= (step / mean_step) ** 0.7
    return path
