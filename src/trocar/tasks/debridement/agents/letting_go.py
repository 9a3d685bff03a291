"""How a fragment comes off the jaws: they open, and if it clings to them, close, open wide, and rub."""

from __future__ import annotations

from functools import partial
from itertools import product

from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.kit.together import together

SHAKES, SHAKEN_RAD = 2, 2.0
"""Jaws that a fragment clings to close and open so wide, so many times. Both fingers draw a charged fragment up between
them, to where it is as wide as they are apart; opened so far they leave it to one of them, most often, below whose face
it hangs, and closing changes how."""
SHAKEN_M = 0.008
"""The first time they rise by this meanwhile: what only lay behind the jaws stays behind."""
STROKES = tuple(product((1.2, 2.0, 0.7), (0.014, 0.013, 0.012)))
"""If it clings still, the tip goes down with jaws open so (rad) to such a height over the work surface (m), and they
close there: the fingers' ends, then 10 mm below the tip, rub what hangs from one of them on the receptacle's floor, or
grasp it. What has not helped in one way is tried in another."""
WAYS = SHAKES + len(STROKES)


async def try_to_shed(arm: RavenArm, number: int) -> None:
    """Try way ``number`` of ``WAYS`` to shake off a fragment that clings; then the jaws are wide open.

    Args:
        arm: over the receptacle.
        number: 0 and on, in shakes; then, over the floor of the receptacle, in strokes.
    """
    if number == 0:
        await together(partial(arm.jaw, 0.0), partial(arm.rise, SHAKEN_M))
    elif number < SHAKES:
        await arm.jaw(0.0)
    else:
        open_rad, height_m = STROKES[number - SHAKES]
        await arm.stroke(arm.places.table_m + height_m, open_rad)
    await arm.jaw(SHAKEN_RAD)
