"""Named setups with their reward."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

from trocar.sutures.rewards import Reward
from trocar.sutures.setup import NeedleGrasp, SutureSetup, base_beside


@dataclass(frozen=True)
class Preset:
    """A setup and how its sutures are judged.

    Attributes:
        setup: the geometry.
        reward: the measure.
        about: one sentence.
    """

    setup: SutureSetup
    reward: Reward
    about: str


PRESETS: dict[str, Preset] = {
    # five numbers (spin, tilt, approach, lean, skew) fitted to Table I and Fig. 3: agreement is plausible, no proof
    "paper-demo": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(-39.8), spin_rad=radians(-30.1)),
            grasp=NeedleGrasp(approach_rad=radians(24.7), lean_rad=radians(43.7), skew_rad=radians(93.0)),
        ),
        Reward(margin="clipped", at="stations", feasible_first=False),
        "fitted to the paper's Table I; its jaws could not hold the needle",
    ),
}
"""Setups by their name on the command line."""
