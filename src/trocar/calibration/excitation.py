"""Random smooth motion for calibration recordings (paper, section IV-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from trocar.errors import TrocarError
from trocar.geometry import TURN

if TYPE_CHECKING:
    from trocar.arms import ArmModel

SAMPLES = 1355
"""Number of data points in the paper's recording, 18 minutes on the robot."""

HARMONICS = 40
BAND = (0.1, 2.2)
"""Frequencies of a joint's motion relative to its pace. Slow components have large amplitudes and fast ones small,
as in the recordings, where a joint reverses 12 to 13 times in a hundred samples."""
SPREAD = 0.7
"""SD of the normal deviate that is mapped to the range: the recordings dwell in its middle (SD .2 of the range)."""

WAKE_RAD = (0.35, 0.30, 0.30)
"""Swing of roll, pitch and yaw that takes up all slack: more than twice the widest identified backlash (.128)."""


@dataclass(frozen=True, eq=False)
class MotionBox:
    """Range and speed of a random motion.

    Attributes:
        lower: (6,) smallest command, rad and m (q3).
        upper: (6,) largest command.
        step: (6,) mean |dq| from sample to sample.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    step: NDArray[np.float64]

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
PSM2_BOX = PSM1_BOX.mirrored()
"""Its mirror image, as recorded in psm2_grey_random."""


def random_smooth_path(
    arm: ArmModel, rng: np.random.Generator, n: int = SAMPLES, box: MotionBox = PSM1_BOX
) -> NDArray[np.float64]:
    """Return a random smooth path (n, 6) that wanders through the whole box and reverses often.

    Each joint is a sum of sinusoids of random frequency and phase, mapped to its range by the normal distribution
    function; its pace is scaled until the mean step is that of the box.

    Raises:
        TrocarError: the box leaves the arm's joint limits, or n is below 2.
    """
    if n < 2:
        raise TrocarError(f"a random path cannot have {n} samples; ask for 2 or more")
    for joint, lower, upper in zip(arm.joints, box.lower, box.upper, strict=True):
        if not joint.lower <= lower < upper <= joint.upper:
            raise TrocarError(
                f"the motion's range [{lower:.4f}, {upper:.4f}] of joint {joint.name!r} is not inside "
                f"[{joint.lower:.4f}, {joint.upper:.4f}]; choose a box within the limits of {arm.name}"
            )
    return np.column_stack([_wander(rng, n, *ends) for ends in zip(box.lower, box.upper, box.step, strict=True)])


def _wander(rng: np.random.Generator, n: int, lower: float, upper: float, step: float) -> NDArray[np.float64]:
    """Return one joint's path (n,) with this mean step."""
    frequency = np.exp(rng.uniform(np.log(BAND[0]), np.log(BAND[1]), HARMONICS))
    phase = rng.uniform(0.0, TURN, HARMONICS)
    amplitude = frequency**-0.75
    amplitude *= SPREAD / np.sqrt(0.5 * np.sum(amplitude**2))
    pace = TURN * step / (upper - lower)
    path = np.full(n, lower)
    for _ in range(20):
        path = ndtr(np.sin(pace * frequency * np.arange(n)[:, None] + phase) @ amplitude)
        path = lower + (upper - lower) * (path - path.min()) / np.ptp(path)
        mean_step = np.abs(np.diff(path)).mean()
        if abs(mean_step - step) < 1e-3 * step:
            break
        pace *= (step / mean_step) ** 0.7
    return path
