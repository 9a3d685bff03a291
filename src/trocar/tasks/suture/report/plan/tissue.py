"""What a plan would do in the tissue, which the planner ignores: as plain values and as warnings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from trocar.tasks.suture.planning.crossing import crossing_sutures
from trocar.tasks.suture.planning.plan import SuturePlan
from trocar.tasks.suture.planning.primitive import comes_out, exit_turn_rad
from trocar.tasks.suture.planning.setup import SutureSetup

PAIRS_NAMED = 3


def tissue_summary(setup: SutureSetup, plan: SuturePlan) -> dict[str, Any]:
    """Return which sutures of a plan cross and whether the needle comes out, angles in degrees."""
    pairs = crossing_sutures(setup, plan.positions_rad, plan.directions)
    exit_rad = exit_turn_rad(setup)
    return {
        "crossing_deg": [[round(math.degrees(plan.positions_rad[i]), 9) for i in pair] for pair in pairs],
        "needle_comes_out": comes_out(setup),
        "needle_turn_deg": math.degrees(setup.insertion.turn_rad),
        "needle_exit_turn_deg": None if math.isnan(exit_rad) else math.degrees(exit_rad),
    }


def tissue_warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return one sentence per problem in the tissue, from the values of ``tissue_summary``."""
    found = []
    if pairs := summary["crossing_deg"]:
        named = ", ".join(f"{one:.4g} and {other:.4g}" for one, other in pairs[:PAIRS_NAMED])
        more = f" and {len(pairs) - PAIRS_NAMED} more pairs" if len(pairs) > PAIRS_NAMED else ""
        found.append(
            f"warning: sutures cross in the tissue, seen from above: {named} deg{more}; ask for wider gaps or fewer "
            "sutures, a larger circle or a smaller needle"
        )
    if not summary["needle_comes_out"]:
        out = summary["needle_exit_turn_deg"]
        enough = "but no rotation brings its tip out" if out is None else f"but its tip comes out at {out:.1f} deg"
        found.append(
            f"warning: the needle never comes out of the tissue: it is turned by {summary['needle_turn_deg']:.1f} deg, "
            f"{enough}; {'shorten the straight path' if out is None else 'turn it farther or push it more often'}"
        )
    return found
