"""The outcome of each fragment, from what really happened. No agent may import this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.eval import Score, agent_explanation
from trocar.tasks.debridement.goals import FragmentOutcome, Workspace
from trocar.tasks.debridement.grips import Closing, closings_of, loss
from trocar.tasks.debridement.truth import DebridementTruth

Event = Mapping[str, Any]

NEAR_M = 0.015
"""A detection belongs to a fragment whose middle is within this distance: fragments are up to 16 mm long, and the
paper's program merges detections within 15 mm."""
SEEN_SHARE = 0.5
"""A fragment counts as visible if both eyes see this share of it; half of it is enough to find its outline."""
SIGHT_S = 0.6
"""The referee checks visibility twice a second. If no check is within this time of an image, everything counts as
visible."""
RELEASE_S = 2.0  # an agent's announcement of a release counts for this long
STILL_M = 1e-3  # a fragment that moves less than this in a tenth of a second is at rest
STILL_S = 0.1
USES = ("allocated", "fragment")  # events that an arm notes when it has acted on a look


@dataclass(frozen=True)
class FragmentScore(Score):
    """One fragment as the referee saw it, with the count of each failure mode of Kehoe 2014, III-B."""

    fragment: int  # its number in the scene
    attempts: int  # closings of jaws that were meant for it, or gripped it
    first_attempt: bool  # it was cleared by the first, without any failure on the way
    recoveries: int  # failures of grasping or movement after which it was still cleared
    fragment_false_negatives: int  # it lay there and was overlooked
    fragment_false_positives: int  # a false detection, to which it was the nearest fragment
    pickup_false_negatives: int  # it was held but not seen in the jaws
    pickup_false_positives: int  # it was seen in the jaws but not held
    grasp_failures: int  # the jaws closed and no part of a fragment was between them
    multiple_grasps: int  # the jaws that were meant for it closed on several
    pickup_failures: int  # it was gripped and lost before it was lifted
    drops_en_route: int  # it was lifted and lost before the receptacle
    dropoff_failures: int  # it was released at the receptacle and ended outside, or still clings to a finger


@dataclass
class _Tally:
    """The closings at one fragment: (row, arm) of each beginning, (row, kind) of each failure."""

    began: list[tuple[int, str]] = field(default_factory=list)
    failures: list[tuple[int, FragmentOutcome]] = field(default_factory=list)

    def count(self, *kinds: FragmentOutcome) -> int:
        """Return how many failures were of one of these kinds."""
        return sum(kind in kinds for _, kind in self.failures)


def score_fragments(truth: DebridementTruth, events: Sequence[Event]) -> list[FragmentScore]:
    """Return one score for each fragment, in the order in which they were cleared.

    Fragments are interchangeable: clearing any three of six reaches the first three goals. The truth alone decides.
    Failure modes 1 to 4 compare the scripts' events with it; else events give only times and descriptions.
    """
    closings = closings_of(truth)
    meant = [_meant(truth, events, closing) for closing in closings]
    tallies = _tallies(truth, events, closings, meant)
    detections = false_detections(truth, events)
    pickups = false_pickups(truth, events, closings, meant)
    entered = cleared_at(truth)
    scores = []
    for k, tally in enumerate(tallies):
        done, end = bool(entered[k] >= 0), float(truth.times_s[-1])
        wrong = [int(counts[k]) for counts in (*detections, *pickups)]
        start_s = _start(truth, events, tally, k)
        noted = _noted(truth, events, tally)
        end_s = float(truth.times_s[entered[k]]) if done else min(float(noted["time_s"]) if noted else end, end)
        failure, reason = ("", "") if done else _why(tally, noted, wrong[0], events)
        refetched = len(tally.failures) - tally.count(FragmentOutcome.MULTIPLE_GRASP)
        scores.append(
            FragmentScore(
                attempted=True,
                succeeded=done,
                failure=failure,
                reason=reason,
                start_s=min(start_s, end_s),
                end_s=end_s,
                fragment=k,
                attempts=len(tally.began),
                first_attempt=done and len(tally.began) == 1 and not tally.failures and not any(wrong),
                recoveries=refetched if done else 0,
                fragment_false_negatives=wrong[0],
                fragment_false_positives=wrong[1],
                pickup_false_negatives=wrong[2],
                pickup_false_positives=wrong[3],
                grasp_failures=tally.count(FragmentOutcome.GRASP_FAILURE),
                multiple_grasps=tally.count(FragmentOutcome.MULTIPLE_GRASP),
                pickup_failures=tally.count(FragmentOutcome.PICKUP_FAILURE),
                drops_en_route=tally.count(FragmentOutcome.DROPPED_EN_ROUTE),
                dropoff_failures=tally.count(FragmentOutcome.DROPOFF_FAILURE, FragmentOutcome.STUCK_IN_JAWS),
            )
        )
    return sorted(scores, key=lambda score: (not score.succeeded, score.end_s, score.fragment))


def cleared_at(truth: DebridementTruth) -> NDArray[np.intp]:
    """Return the row (k,) from which each fragment stays in the receptacle; -1 if it does not rest there."""
    inside = truth.between_walls & ~truth.held
    since = np.searchsorted(truth.times_s, truth.times_s[-1] - STILL_S)
    middle = truth.p_world_fragments_m
    still = np.linalg.norm(middle[since:] - middle[-1], axis=-1).max(axis=0) < STILL_M
    outside = [np.flatnonzero(~column) for column in inside.T]
    rows = np.array([rows[-1] + 1 if len(rows) else 0 for rows in outside])
    return np.where(inside[-1] & still & ~truth.touched[-1], rows, -1)


def _said(events: Sequence[Event], name: str, arm: str) -> list[Event]:
    """Return what an arm's script noted under a name."""
    return [event for event in events if event["name"] == name and event.get("arm") == arm]


def _meant(truth: DebridementTruth, events: Sequence[Event], closing: Closing) -> int:
    """Return the fragment that a closing was meant for: the one at the allocated place, else the nearest to the tip."""
    loose = ~truth.between_walls[closing.start] & ~truth.held[closing.start]
    begun = float(truth.times_s[closing.start])
    said = [e for e in _said(events, "allocated", closing.arm) if e["time_s"] <= begun]
    if said:
        row = truth.row(float(said[-1]["time_s"]))
        away = np.linalg.norm(truth.p_world_fragments_m[row] - np.asarray(said[-1]["place"]), axis=-1)
        if loose.any() and away[loose].min() < NEAR_M:
            return int(np.where(loose, away, np.inf).argmin())
    tip = truth.T_world_tips[closing.arm].translation_m[closing.closed]
    away = np.linalg.norm(truth.p_world_fragments_m[closing.start] - tip, axis=-1)
    return int(np.where(loose, away, np.inf).argmin() if loose.any() else away.argmin())


def _tallies(
    truth: DebridementTruth, events: Sequence[Event], closings: Sequence[Closing], meant: Sequence[int]
) -> list[_Tally]:
    tallies = [_Tally() for _ in range(truth.count)]
    for closing, aim in zip(closings, meant, strict=True):
        gripped = closing.gripped
        target = aim if aim in gripped or not gripped else gripped[0]
        for k in {target, *gripped}:
            tallies[k].began.append((closing.start, closing.arm))
        if not gripped:
            tallies[target].failures.append((closing.closed, FragmentOutcome.GRASP_FAILURE))
        if len(gripped) > 1:
            tallies[target].failures.append((closing.closed, FragmentOutcome.MULTIPLE_GRASP))
        for k in gripped:
            lost, row = loss(truth, closing, k, _let_go(truth, events, closing))
            if lost is not None:
                tallies[k].failures.append((row, lost))
    return tallies


def _let_go(truth: DebridementTruth, events: Sequence[Event], closing: Closing) -> bool:
    """Return whether the agent announced a release when these jaws opened again."""
    opened = float(truth.times_s[closing.opened])
    said = _said(events, "releasing", closing.arm)
    return any(opened - RELEASE_S < e["time_s"] <= opened + STILL_S for e in said)


def _start(truth: DebridementTruth, events: Sequence[Event], tally: _Tally, fragment: int) -> float:
    """Return when a fragment was first allocated or jaws first closed for it, whichever is earlier; else the end."""
    times = [float(truth.times_s[row]) for row, _ in tally.began]
    for event in events:
        if event["name"] == "allocated":
            there = truth.p_world_fragments_m[truth.row(float(event["time_s"])), fragment]
            if np.linalg.norm(there - np.asarray(event["place"])) < NEAR_M:
                times.append(float(event["time_s"]))
    return min(times, default=float(truth.times_s[-1]))


def _noted(truth: DebridementTruth, events: Sequence[Event], tally: _Tally) -> Event | None:
    """Return the event with which the arm that last closed its jaws on a fragment noted the outcome, or None."""
    if not tally.began:
        return None
    row, arm = max(tally.began)
    return next((e for e in _said(events, "fragment", arm) if e["time_s"] >= truth.times_s[row]), None)


def _why(tally: _Tally, noted: Event | None, overlooked: int, events: Sequence[Event]) -> tuple[str, str]:
    """Return the name of the failure and a sentence: what last happened to the fragment, else the script's own."""
    last = max(((row, kind.name) for row, kind in tally.failures), default=(0, ""))[1]
    said = agent_explanation(noted, events)
    if last:
        return last, said[1] if said and said[0] == last and said[1] else FragmentOutcome[last].value
    if said is not None and said[0] != FragmentOutcome.DONE.name:
        return said
    kind = FragmentOutcome.NOT_FOUND if overlooked else FragmentOutcome.NOT_CLEARED
    return kind.name, kind.value


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
    """Return how often an agent's last judgement of a grip was wrong (k,): held but not seen; seen but not held."""
    unseen, imagined = np.zeros((2, truth.count), dtype=np.intp)
    for closing, target in zip(closings, meant, strict=True):
        first, last = truth.times_s[closing.closed], truth.times_s[closing.next]
        said = [e for e in _said(events, "pickup", closing.arm) if first < float(e["image_s"]) <= last]
        if not said:
            continue
        held = np.flatnonzero(truth.held_by[closing.arm][truth.row(float(said[-1]["image_s"]))])
        if said[-1]["holding"] and not len(held):
            imagined[target] += 1
        if not said[-1]["holding"] and len(held):
            unseen[target if target in held else held[0]] += 1
    return unseen, imagined


def _acted_on(events: Sequence[Event], number: int) -> bool:
    """Return whether an agent acted on a look, or stopped, before it looked again."""
    arm = events[number].get("arm")
    for later in events[number + 1 :]:
        if later["name"] == "stopped" or (later["name"] in USES and later.get("arm") == arm):
            return True
        if later["name"] == "detected" and later.get("arm") == arm:
            return False
    return True


def _visible(truth: DebridementTruth, row: int) -> NDArray[np.bool_]:
    """Return which fragments (k,) lie free in the region and can be seen."""
    low, high = np.array(Workspace().region_m)
    middle = truth.p_world_fragments_m[row]
    there = ((middle[:, :2] > low - NEAR_M) & (middle[:, :2] < high + NEAR_M)).all(axis=1)
    there &= middle[:, 2] - truth.table_z_m < NEAR_M
    there &= ~truth.touched[row] & ~truth.between_walls[row]
    sights = truth.sights
    if len(sights.times_s):
        nearest = int(np.abs(sights.times_s - truth.times_s[row]).argmin())
        if abs(sights.times_s[nearest] - truth.times_s[row]) <= SIGHT_S:
            there &= sights.seen[nearest] >= SEEN_SHARE
    return there
