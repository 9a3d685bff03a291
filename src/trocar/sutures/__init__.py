"""Where to place stay sutures round a circle, and in which direction to drive each (Thananjeyan et al. 2019)."""

from trocar.sutures.continuous import plan_continuous
from trocar.sutures.enclosure import DexterityEnclosure, interpolated_bounds
from trocar.sutures.even import plan_even, plan_exhaustive
from trocar.sutures.gaps import plan_gaps
from trocar.sutures.joints import SutureJoints, suture_joints
from trocar.sutures.plan import Spacing, SuturePlan
from trocar.sutures.presets import PRESETS, Preset
from trocar.sutures.rewards import MARGINS, DexterityMap, Reward, dexterity
from trocar.sutures.setup import (
    CLOCKWISE,
    COUNTERCLOCKWISE,
    DIRECTIONS,
    Circle,
    Insertion,
    Needle,
    NeedleGrasp,
    SutureSetup,
    base_beside,
)

__all__ = [
    "CLOCKWISE",
    "COUNTERCLOCKWISE",
    "DIRECTIONS",
    "MARGINS",
    "PRESETS",
    "Circle",
    "DexterityEnclosure",
    "DexterityMap",
    "Insertion",
    "Needle",
    "NeedleGrasp",
    "Preset",
    "Reward",
    "Spacing",
    "SutureJoints",
    "SuturePlan",
    "SutureSetup",
    "base_beside",
    "dexterity",
    "interpolated_bounds",
    "plan_continuous",
    "plan_even",
    "plan_exhaustive",
    "plan_gaps",
    "suture_joints",
]
