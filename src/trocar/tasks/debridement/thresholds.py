"""Thresholds of the referee of debridement, each with its reason. No agent may import this."""

NEAR_M = 0.015
"""A detection belongs to a fragment whose middle is within this distance: fragments are up to 14 mm long, and the
paper's program merges detections within 15 mm (facts/debridement.md)."""

SEEN_SHARE = 0.5
"""A fragment counts as visible if both eyes see this share of it; half of it is enough to find its outline."""

SIGHT_S = 0.6
"""The referee checks visibility twice a second; for an image further than this from every check, everything counts as
visible."""

CLOSING_RAD = 0.15
"""Jaws that close by less have only trembled: .15 rad are 3 mm at the fingers' ends, half of the smallest fragment."""

ENOUGH_RAD = 0.02
"""Jaws have closed when they are this close to their final opening; foam under the teeth creeps by a hundredth."""

STALL_S = 0.3
"""Jaws that have not moved for this long have stopped; commands that close them in steps come more often."""

RISEN_M = 0.005
"""A closing is over when the jaws have risen this far; later actions are in the air."""

NEAR_TABLE_M = 0.030
"""Jaws that close higher above the surface than this cannot reach a fragment, which is 9 mm high at most: the
controlled point is 10 mm behind the fingers' ends, and open jaws close downwards by 4 mm."""

GRIP_S = 0.2
"""Once closed, the jaws are judged for this long: foam that squirts out is gone by then, and no arm has risen by 10 mm,
at 5 cm/s."""

FLICKER_S = 0.1
"""A grip that opens for less was not lost, since contacts flicker for single ticks."""

LIFTED_M = 0.030
"""Lost before the jaws have risen this far: a pickup failure; later: dropped on the way. The paper lifts by 50 mm, and
from 30 mm on nothing that stays on the surface can hold a fragment back."""

BESIDE_M = 0.040
"""Jaws that open within this distance of the receptacle were aimed at it: their pose is off by 38 mm at worst."""

CARRIED_M = 0.020
"""And only if they moved this far, seen from above: jaws that open where they closed put the fragment back."""

RELEASE_S = 2.0
"""An agent's announcement of a release counts for this long."""

REST_S = 0.5
"""A free fragment is judged after this time: it falls 10 cm in .14 s, and then it may roll."""

STILL_M = 1e-3
"""A fragment that moves less than this in a tenth of a second is at rest."""
STILL_S = 0.1
