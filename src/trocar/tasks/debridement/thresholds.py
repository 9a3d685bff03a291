"""Where the referee of debridement draws its lines, each with its reason. No agent may import this."""

NEAR_M = 0.015
"""A detection belongs to a fragment whose middle is so near: fragments are up to 14 mm long, and the paper's program
merges detections within 15 mm (facts/debridement.md)."""

SEEN_SHARE = 0.5
"""A fragment counts as visible when both eyes see so much of it: half of it is enough to find its outline."""

SIGHT_S = 0.6
"""The referee looks at what is visible twice a second; an image further from every look is judged as if all were."""

CLOSING_RAD = 0.15
"""Jaws that close by less have trembled: .15 rad are 3 mm at the fingers' ends, half of the smallest fragment."""

ENOUGH_RAD = 0.02
"""Jaws have closed when they are so near to where they stop: foam under the teeth creeps by a hundredth."""

STALL_S = 0.3
"""Jaws that have not moved for so long stand still; commands that close them in steps come more often."""

RISEN_M = 0.005
"""A closing is over when the jaws have risen so far: what they do then, they do in the air."""

NEAR_TABLE_M = 0.030
"""Jaws that close higher above the surface than this cannot reach a fragment, which is 9 mm high at most: the
controlled point is 10 mm behind the fingers' ends, and open jaws close downwards by 4 mm."""

GRIP_S = 0.2
"""Once they have closed, the jaws are judged for so long: foam that squirts out is gone by then, and no arm has risen
by 10 mm, at 5 cm/s."""

FLICKER_S = 0.1
"""A grip that opens for less was not lost: contacts flicker for single ticks."""

LIFTED_M = 0.030
"""Lost before the jaws have risen so far: failed to pick up; later: dropped on the way. The paper lifts by 50 mm, and
from 30 mm on nothing that stays on the surface can hold a fragment back."""

BESIDE_M = 0.040
"""Jaws that open no further beside the receptacle than this meant it: their pose is off by 38 mm at the worst."""

CARRIED_M = 0.020
"""And only if they were carried so far, seen from above: jaws that open where they closed put the fragment back."""

RELEASE_S = 2.0
"""An agent's word that it lets go counts for so long."""

REST_S = 0.5
"""A fragment that is free is judged when it had so long to fall: from 10 cm it takes .14 s, and then it may roll."""

STILL_M = 1e-3
"""A fragment rests that moves less than this in a tenth of a second."""
STILL_S = 0.1
