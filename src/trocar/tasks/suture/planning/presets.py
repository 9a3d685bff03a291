"""Named setups, each with its reward."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

from trocar.tasks.suture.planning.rewards import Reward
from trocar.tasks.suture.planning.setup import NeedleGrasp, SutureSetup, base_beside


@dataclass(frozen=True)
class Preset:
    """A setup and the reward that scores its sutures.

    Attributes:
        setup: the geometry.
        reward: how sutures are scored.
    """

    setup: SutureSetup
    reward: Reward


PRESETS: dict[str, Preset] = {
    # Flat jaws can hold the needle, the wrist stays clear of the tissue, and every position is within reach. The base
    # stands where the demo's does; the angles of base and grasp maximise the worst position, in steps of 5 degrees.
    "default": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(40.0), spin_rad=radians(-135.0)),
            grasp=NeedleGrasp(radians(135.0), approach_rad=radians(-10.0), lean_rad=radians(30.0)),
        ),
        Reward(),
    ),
    # Five parameters (spin, tilt, approach, lean, skew) are fitted to the paper's Table I and Fig. 3: the agreement is
    # plausible, no proof. Flat jaws could not hold the needle in this grasp.
    "paper-demo": Preset(
        SutureSetup(
            T_world_base=base_beside(radians(225.0), 0.050, 0.100, tilt_rad=radians(-40.0), spin_rad=radians(-30.5)),
            grasp=NeedleGrasp(approach_rad=radians(26.2), lean_rad=radians(51.0), skew_rad=radians(90.5)),
        ),
        Reward(margin="clipped", at="stations", feasible_first=False),
    ),
}
"""Setups by their name on the command line."""
