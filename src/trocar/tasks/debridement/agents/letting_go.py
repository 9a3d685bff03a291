"""How a fragment is released: the jaws open and, if it clings to them, close, open wide, and rub it off."""

from __future__ import annotations

from functools import partial
from itertools import product

from trocar.robots.concurrency import together
from trocar.tasks.debridement.agents.raven_arm import RavenArm

SHAKES, SHAKEN_RAD = 2, 2.0
"""Jaws to which a fragment clings close and open this wide, this many times. Both fingers pull a charged fragment up
between them, to where it is as wide as their gap; opened this far, mostly only one of them keeps it, hanging below its
face, and closing changes how it hangs."""
SHAKEN_M = 0.008
"""The first time they rise by this meanwhile, so that a fragment that merely lay behind the jaws stays behind."""
STROKES = tuple(product((1.2, 2.0, 0.7), (0.014, 0.013, 0.012)))
"""If it still clings, the tip goes down with this jaw opening (rad) to this height over the work surface (m), and the
jaws close there: the fingers' ends, then 10 mm below the tip, rub what hangs from one of them on the receptacle's
floor, or grasp it. If one way does not help, another is tried."""
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
