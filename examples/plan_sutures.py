"""Plan stay sutures round a hernia mesh and draw them: python examples/plan_sutures.py [PICTURE]."""

import sys
from pathlib import Path

import numpy as np

from trocar.tasks.suture.planning import PRESETS, Spacing, dexterity, plan_even, plan_gaps
from trocar.tasks.suture.report.circle import draw_plan

preset = PRESETS["default"]  # or a SutureSetup and a Reward of your own
sutures = dexterity(preset.setup, preset.reward)  # dexterity all round the circle, in both directions
plan = plan_even(sutures, count=4)  # the paper's problem
freer = plan_gaps(sutures, count=4, spacing=Spacing(np.radians(75), np.radians(105)))
print(f"{np.degrees(plan.positions_rad)} deg, {plan.directions}: {plan.reward:.3f}")
print(f"with gaps of 75 to 105 deg: {freer.reward:.3f}")

print(draw_plan(sutures, plan, Path(sys.argv[1] if len(sys.argv) > 1 else "out/sutures.png")))
