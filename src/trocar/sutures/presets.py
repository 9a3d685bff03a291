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
    # grasp and base turned so that the worst position round the circle is best, in whole 5 degrees; base as the demo's
    "default": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(40.0), spin_rad=radians(-135.0)),
            grasp=NeedleGrasp(radians(135.0), approach_rad=radians(-10.0), lean_rad=radians(30.0)),
        ),
        Reward(),
        "jaws hold the needle across their flat faces, wrist clear of the tissue; every position can be reached",
    ),
    # five numbers (spin, tilt, approach, lean, skew) fitted to Table I and Fig. 3: agreement is plausible, no proof
    "paper-demo": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(-40.0), spin_rad=radians(-30.5)),
            grasp=NeedleGrasp(approach_rad=radians(26.2), lean_rad=radians(51.0), skew_rad=radians(90.5)),
        ),
        Reward(margin="clipped", at="stations", feasible_first=False),
        "fitted to the paper's Table I; its jaws could not hold the needle",
    ),
}
"""Setups by their name on the command line."""
