"""What an agent claimed to see, compared with the truth (Kehoe 2014, III-B, modes 1 to 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.tasks.debridement.grips import Closing
from trocar.tasks.debridement.thresholds import NEAR_M, SEEN_SHARE, SIGHT_S
from trocar.tasks.debridement.truth import DebridementTruth
from trocar.tasks.debridement.workspace import Workspace

Event = Mapping[str, Any]
USES = ("allocated", "fragment", "stopped")
"""Events that an agent notes when it has acted on a look."""


def false_detections(truth: DebridementTruth, events: Sequence[Event]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return how often each fragment was overlooked, and how often a fragment was falsely seen near it: (k,).

    A fragment is overlooked if an agent acts on a look that did not show it, although it lay free and visible in the
    region. Consecutive looks that overlook the same one count once; so do consecutive looks with the same false
    detection. A false detection is attributed to the nearest fragment.
    """
    missed, phantoms = np.zeros((2, truth.count), dtype=np.intp)
    missing = np.zeros(truth.count, dtype=bool)
    before = np.zeros((0, 3))
    for number, event in enumerate(events):
        if event["name"] != "detected":
            continue
        row = truth.row(float(event["image_s"]))
        places = np.asarray(event["fragments"], dtype=np.float64).reshape(-1, 3)
        true = truth.p_world_fragments_m[row]
        away = np.linalg.norm(places[:, None] - true, axis=-1)
        found = (away < NEAR_M).any(axis=0)
        overlooked = _visible(truth, row) & ~found
        if _acted_on(events, number):
            missed += overlooked & ~missing
            missing |= overlooked
        missing &= ~found
        nothing = places[(away >= NEAR_M).all(axis=1)]
        for place in nothing:
            if not (np.linalg.norm(before - place, axis=-1) < NEAR_M).any():
                phantoms[np.linalg.norm(true - place, axis=-1).argmin()] += 1
        before = nothing
    return missed, phantoms


def false_pickups(
    truth: DebridementTruth, events: Sequence[Event], closings: Sequence[Closing], meant: Sequence[int]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return how often an agent's last judgement of a grip was wrong, by fragment (k,): held but not seen; reverse.

    Args:
        truth: what happened.
        events: what was noted.
        closings: of all arms.
        meant: the fragment for which each was meant.
    """
    unseen, imagined = np.zeros((2, truth.count), dtype=np.intp)
    for closing, target in zip(closings, meant, strict=True):
        first, last = truth.times_s[closing.closed], truth.times_s[closing.next]
        said = [e for e in events if e["name"] == "pickup" and e.get("arm") == closing.arm]
        said = [e for e in said if first < float(e["image_s"]) <= last]
        if not said:
            continue
        held = np.flatnonzero(truth.held_by[closing.arm][truth.row(float(said[-1]["image_s"]))])
        if said[-1]["holding"] and not len(held):
            imagined[target] += 1
        if not said[-1]["holding"] and len(held):
            unseen[target if target in held else held[0]] += 1
    return unseen, imagined


def _acted_on(events: Sequence[Event], number: int) -> bool:
    """Return whether an agent acted on a look before it looked again or stopped looking."""
    event = events[number]
    arms = event.get("arms") or [event.get("arm")]
    for later in events[number + 1 :]:
        theirs = later.get("arms") or [later.get("arm")]
        if later["name"] == "detected" and set(theirs) & set(arms):
            return False
        if later["name"] in USES and (later.get("arm") in arms or later["name"] == "stopped"):
            return True
    return True


def _visible(truth: DebridementTruth, row: int) -> NDArray[np.bool_]:
    """Return which fragments (k,) lie free in the region and can be seen."""
    (x_low, y_low), (x_high, y_high) = Workspace().region_m
    low = np.array([x_low, y_low]) - NEAR_M
    high = np.array([x_high, y_high]) + NEAR_M
    middle = truth.p_world_fragments_m[row]
    there = ((middle[:, :2] > low) & (middle[:, :2] < high)).all(axis=1)
    there &= middle[:, 2] - truth.table_z_m < NEAR_M
    there &= ~truth.touched[row] & ~truth.between_walls[row]
    sights = truth.sights
    if len(sights.times_s):
        nearest = int(np.abs(sights.times_s - truth.times_s[row]).argmin())
        if abs(sights.times_s[nearest] - truth.times_s[row]) <= SIGHT_S:
            there &= sights.seen[nearest] >= SEEN_SHARE
    return there
