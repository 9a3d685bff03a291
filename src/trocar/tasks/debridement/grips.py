"""Closings of jaws on fragments, and what happened to the fragments they held, from the truth alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.debridement.goals import FragmentOutcome
from trocar.tasks.debridement.truth import DebridementTruth

CLOSING_RAD = 0.15
"""Jaws that close by less have only trembled: this is 3 mm at the fingers' ends; fragments are 8 mm wide or more."""
ENOUGH_RAD = 0.02
"""Jaws have closed when they are this close to their final opening; foam under the teeth creeps by a hundredth."""
STALL_S = 0.3
"""Jaws that have not moved for this long have stopped; commands that close them in steps come more often."""
RISEN_M = 0.005  # a closing is over when the jaws have risen this far; later actions are in the air
NEAR_TABLE_M = 0.030
"""Jaws that close higher above the surface than this cannot reach a fragment, which is 12 mm high at most: the
controlled point is 10 mm behind the fingers' ends, and open jaws close downwards by 4 mm."""
GRIP_S = 0.2
"""Once closed, the jaws are judged for this long: foam that squirts out is gone by then, and no arm has risen by more
than 10 mm, at 5 cm/s."""
FLICKER_S = 0.1  # a grip that opens for less was not lost, since contacts flicker for single ticks
LIFTED_M = 0.030
"""A loss before the jaws have risen this far is a pickup failure, a later one a drop on the way. The paper lifts by
50 mm; from 30 mm on nothing that stays on the surface can hold a fragment back."""
BESIDE_M = 0.040
"""Jaws that open within this distance of the receptacle were aimed at it: their pose is off by 38 mm at worst."""
CARRIED_M = 0.020
"""Jaws count as aimed at the receptacle only if they moved this far, seen from above: jaws that open where they closed
put the fragment back."""
REST_S = 0.5  # a free fragment is judged after this time: it falls 10 cm in .14 s, and then it may roll


@dataclass(frozen=True)
class Closing:
    """One closing of an arm's jaws near the work surface; rows of the truth."""

    arm: str  # whose
    start: int  # when the jaws began to close
    closed: int  # when they had closed
    opened: int  # when they began to open again; the last row if they did not
    next: int  # when the arm's next closing begins; the last row if there is none
    gripped: tuple[int, ...]  # fragments that were between the closed fingers


def closings_of(truth: DebridementTruth) -> list[Closing]:
    """Return all closings of all arms near the work surface and beside the receptacle, in order of time."""
    found = [closing for arm in truth.jaw_rad for closing in _of_arm(truth, arm)]
    return sorted(found, key=lambda closing: (closing.start, closing.arm))


def loss(
    truth: DebridementTruth, closing: Closing, fragment: int, announced: bool
) -> tuple[FragmentOutcome | None, int]:
    """Return how a gripped fragment was lost, and the row at which it left the jaws.

    None if it was delivered, put back where it lay, or kept to the end. ``announced``: whether the agent announced a
    release; this only distinguishes a regrasp from a release far beside the receptacle.
    """
    held = truth.held_by[closing.arm][:, fragment]
    tip = truth.T_world_tips[closing.arm].translation_m
    left = _left(truth, held, closing)
    if left is None:
        return (FragmentOutcome.STUCK_IN_JAWS if closing.opened < len(held) - 1 else None), len(held) - 1
    rise = float(tip[left, 2] - tip[closing.closed, 2])
    over = bool(truth.over_receptacle(tip[left]))
    if left < closing.opened - _rows(truth, FLICKER_S):  # the jaws were closed
        if over:
            return _landed(truth, closing, fragment, left), left
        return (FragmentOutcome.PICKUP_FAILURE if rise < LIFTED_M else FragmentOutcome.DROPPED_EN_ROUTE), left
    carried = float(np.linalg.norm(tip[left, :2] - tip[closing.closed, :2])) > CARRIED_M
    near = carried and bool(truth.over_receptacle(tip[left], BESIDE_M))
    return (_landed(truth, closing, fragment, left) if over or near or announced else None), left


def legs(jaw_rad: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return (first, last) row of each closing of jaws (n,), from its highest to its lowest point."""
    found: list[tuple[int, int]] = []
    high = low = 0
    closing = False
    for row, now in enumerate(jaw_rad):
        if closing:
            if now < jaw_rad[low]:
                low = row
            elif now > jaw_rad[low] + CLOSING_RAD:
                found.append((high, low))
                closing, high = False, row
        elif now >= jaw_rad[high]:
            high = row
        elif now < jaw_rad[high] - CLOSING_RAD:
            closing, low = True, row
    return [*found, (high, low)] if closing else found


def _of_arm(truth: DebridementTruth, arm: str) -> list[Closing]:
    """Return the closings of one arm near the work surface, in order of time."""
    jaw, tip, found = truth.jaw_rad[arm], truth.T_world_tips[arm].translation_m, []
    for (start, low), (following, _) in pairwise([*legs(jaw), (len(jaw) - 1, 0)]):
        stop = next((row for row in _stalls(truth, jaw, start, low) if _at_work(truth, tip[row])), None)
        if stop is None:
            continue
        risen = np.flatnonzero(tip[stop : low + 1, 2] > tip[stop, 2] + RISEN_M)
        lowest = start + int(np.argmin(jaw[start : (stop + int(risen[0]) if len(risen) else low) + 1]))
        closed = start + int(np.argmax(jaw[start : lowest + 1] <= jaw[lowest] + ENOUGH_RAD))
        if not _at_work(truth, tip[closed]):
            continue
        rest = jaw[lowest : following + 1]
        opening = np.flatnonzero(rest > np.minimum.accumulate(rest) + 2 * ENOUGH_RAD)
        opened = lowest + int(opening[0]) if len(opening) else following
        rows = slice(closed, max(closed + 1, min(closed + _rows(truth, GRIP_S), opened) + 1))
        gripped = np.flatnonzero(truth.held_by[arm][rows].mean(axis=0) >= 0.5)
        found.append(Closing(arm, start, closed, opened, following, tuple(gripped.tolist())))
    return found


def _at_work(truth: DebridementTruth, tip_m: NDArray[np.float64]) -> bool:
    """Return whether jaws at this tip (3,) can reach a fragment on the work surface."""
    return bool(tip_m[2] - truth.table_z_m <= NEAR_TABLE_M and not truth.over_receptacle(tip_m))


def _stalls(truth: DebridementTruth, jaw: NDArray[np.float64], start: int, low: int) -> list[int]:
    """Return the rows of a closing at which the jaws stopped; they close further if they lose what they hold."""
    later = np.minimum(np.arange(start, low + 1) + _rows(truth, STALL_S), low)
    still = (jaw[start] - jaw[start : low + 1] > CLOSING_RAD) & (jaw[start : low + 1] - jaw[later] < ENOUGH_RAD)
    begins = np.flatnonzero(still & ~np.append(False, still[:-1]))
    return [*(start + begins).tolist(), low]


def _left(truth: DebridementTruth, held: NDArray[np.bool_], closing: Closing) -> int | None:
    """Return the row after which a fragment was no longer between the fingers, except for flickers; None: never."""
    rows = closing.closed + np.flatnonzero(held[closing.closed :])
    if not len(rows):
        return closing.closed
    gaps = np.flatnonzero(np.diff(truth.times_s[rows]) > FLICKER_S)
    last = int(rows[gaps[0]] if len(gaps) else rows[-1])
    return None if truth.times_s[-1] - truth.times_s[last] <= FLICKER_S else last


def _landed(truth: DebridementTruth, closing: Closing, fragment: int, left: int) -> FragmentOutcome | None:
    """Return how a release at the receptacle failed, judged once no finger has touched the fragment for a while.

    A charged fragment may cling to a finger for longer, touching it now and then.
    """
    touched = np.flatnonzero(truth.touched_by[closing.arm][left:, fragment])
    begins = left + np.append(0, touched + 1)
    ends = np.append(left + touched, len(truth.times_s))
    rested = np.flatnonzero(ends - begins > _rows(truth, REST_S))
    if len(rested):
        judged = int(begins[rested[0]]) + _rows(truth, REST_S)
    elif ends[-1] > begins[-1]:
        judged = len(truth.times_s) - 1
    else:
        return FragmentOutcome.STUCK_IN_JAWS
    return None if truth.between_walls[judged, fragment] else FragmentOutcome.DROPOFF_FAILURE


def _rows(truth: DebridementTruth, seconds: float) -> int:
    """Return a time as a number of rows of the truth."""
    if len(truth.times_s) < 2:
        return 0
    return round(seconds / float(truth.times_s[1] - truth.times_s[0]))
