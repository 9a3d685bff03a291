"""Where to place stay sutures round a circle, and in which direction to drive each (Thananjeyan et al. 2019)."""

from trocar.tasks.suture.needle import NEEDLES, Needle
from trocar.tasks.suture.planning.grid import plan_even, plan_gaps, refined
from trocar.tasks.suture.planning.plan import Spacing, SuturePlan
from trocar.tasks.suture.planning.primitive import Suture, SutureJoints, suture_joints, sutures_at
from trocar.tasks.suture.planning.rewards import MARGINS, PRESETS, DexterityMap, Preset, Reward, dexterity
from trocar.tasks.suture.planning.settings import preset_of, with_settings
from trocar.tasks.suture.planning.setup import (
    CLOCKWISE,
    COUNTERCLOCKWISE,
    DIRECTIONS,
    Circle,
    Insertion,
    NeedleGrasp,
    SutureSetup,
    base_beside,
)
from trocar.tasks.suture.planning.waypoints import Waypoints, waypoints

__all__ = [
    "CLOCKWISE",
    "COUNTERCLOCKWISE",
    "DIRECTIONS",
    "MARGINS",
    "NEEDLES",
    "PRESETS",
    "Circle",
    "DexterityMap",
    "Insertion",
    "Needle",
    "NeedleGrasp",
    "Preset",
    "Reward",
    "Spacing",
    "Suture",
    "SutureJoints",
    "SuturePlan",
    "SutureSetup",
    "Waypoints",
    "base_beside",
    "dexterity",
    "plan_even",
    "plan_gaps",
    "preset_of",
    "refined",
    "suture_joints",
    "sutures_at",
    "waypoints",
    "with_settings",
]
