"""Find a needle that jaws have lost: on its path through the tissue, or on the phantom if it fell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trocar.arms import fk
from trocar.geometry import SE3
from trocar.perception.image import RgbdImage
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.needle_estimator import NeedleEstimate
from trocar.tasks.suture.agents.needle_tracker import NeedleTracker, Stretch
from trocar.tasks.suture.lying_needle import LyingNeedle, find_lying
from trocar.tasks.suture.needle import Needle
from trocar.tasks.suture.planning.clearance import fingers_above_m
from trocar.tasks.suture.planning.pull import OVER_TISSUE_M, Grip, over_tissue_m, reach_segment, tail_out_rad
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.stand import PHANTOM_M

if TYPE_CHECKING:
    from trocar.tasks.suture.agents.circle import CircleSuturing

APART_RAD = math.radians(25.0)
"""Largest rotation between the poses on the needle's path at which the search for it starts."""
ON_ARC = np.diag(np.array([0.8e-3, 0.8e-3, 0.8e-3, 0.05, 0.05, 0.16]) ** 2)
"""How well a needle near one of these poses is known: covariance of a twist in its frame, m and rad."""
LOOKING_OVER_S = 0.5
"""Declared time to find a needle in an image of the whole phantom."""
STEP_RAD = math.radians(1.0)
OFF_ARC_M = 2.0e-3
"""A needle whose tip or tail is further than this from its path is not on the path."""


def places_on_arc(grip: Grip) -> Iterator[NeedleEstimate]:
    """Yield possible poses, in the arm's base, of a needle that this grip lost; the end of the grip first."""
    first, last = grip.turn_rad[0], tail_out_rad(grip.setup)
    turns = np.linspace(last, first, 1 + math.ceil((last - first) / APART_RAD))
    for turn in sorted(turns, key=lambda each: abs(each - grip.turn_rad[1])):
        T_circle_needle = grip.T_circle_needle(np.array([turn]))[0]
        yield NeedleEstimate(grip.setup.T_base_circle @ T_circle_needle, ON_ARC)


def grip_from(grip: Grip, T_base_needle: SE3) -> Grip | None:
    """Return the rest of a grip for a needle that rests here.

    None if the needle is not on its path, or open jaws would meet the tissue there.
    """
    turns = np.arange(grip.turn_rad[0], tail_out_rad(grip.setup), STEP_RAD)
    T_circle_needle = grip.setup.T_base_circle.inverse() @ T_base_needle
    at = nearest_pose(grip.T_circle_needle(turns), T_circle_needle, grip.setup.needle)
    if at is None:
        return None
    turn = float(turns[at])
    left = replace(grip, turn_rad=(turn, max(turn, grip.turn_rad[1])))
    return left if _clear(left) else None


def _clear(grip: Grip) -> bool:
    """Return whether open jaws, wrist and shaft stay above the tissue on their way to a grip."""
    setup, q = grip.setup, reach_segment(grip).q
    if not np.isfinite(q).all():
        return False
    tip = grip.T_circle_needle(np.array([grip.turn_rad[0]])) @ setup.grasp.pose(setup.needle.radius_m)
    fingers_m = fingers_above_m(setup.arm, tip, np.ones(1, dtype=bool))
    return bool(fingers_m.min() > OVER_TISSUE_M and over_tissue_m(setup, q).min() > OVER_TISSUE_M)


async def drive_on(agent: CircleSuturing, number: int, segment: Segment) -> bool:
    """Find the needle that the first arm lost along a segment, take it again, and drive it to the end.

    Returns:
        Whether the jaws hold it there; else they are open.
    """
    hand, tracker, open_rad = agent.hand, agent.tracker, agent.settings.jaw_open_rad
    agent.log.event("needle lost", arm=hand.name)
    await hand.jaw(open_rad)
    if tracker is None:
        return False
    way = fk(hand.model, segment.q) @ tracker.T_tip_needle_planned
    arc_rad = float(np.linalg.norm((way[0].inverse() @ way[-1]).log()[3:]))
    count = len(segment.q) - 1
    for place in np.linspace(count, 0, 1 + math.ceil(arc_rad / APART_RAD)).round().astype(int):
        tracker.rests(NeedleEstimate(way[int(place)], ON_ARC))
        await tracker.look()
        if tracker.seen:
            break
    at = nearest_pose(way, tracker.needle.T_base_needle, tracker.setup.needle) if tracker.seen else None
    if at is None:
        return False
    left = replace(segment, q=segment.q[at:], length_m=segment.length_m * (count - at) / max(1, count))
    back = tracker.towards_needle(replace(left, q=left.q[::-1]), way[at])
    if await agent.follow(number, back) or not await agent.grip():
        await hand.jaw(open_rad)
        return False
    tracker.gripped(lost=True)
    if len(left.q) > 1:
        await agent.follow(number, tracker.path(Stretch(left, first=False)))
    if hand.jaw_rad > agent.settings.jaw_empty_rad:
        return True
    await hand.jaw(open_rad)
    return False


def nearest_pose(way: SE3, T_needle: SE3, needle: Needle) -> int | None:
    """Return the index of the pose (n,) on a path that is nearest to a needle's; None if it is not on the path."""
    ends = needle.point_m(np.array([0.0, needle.arc_rad]))
    places = [np.linalg.norm(way.apply(end) - at, axis=-1) for end, at in zip(ends, T_needle.apply(ends), strict=True)]
    off_m = np.max(places, axis=0)
    best = int(np.argmin(off_m))
    return best if off_m[best] < OFF_ARC_M else None


async def look_over(tracker: NeedleTracker, hand: ArmScript) -> LyingNeedle | None:
    """Look at the whole phantom, with no arm in the way; return where a needle lies on it, None if none is seen."""
    image = await tracker.camera.capture()
    T_camera_floor = tracker.T_base_camera.inverse() @ tracker.setup.T_base_circle
    if not isinstance(image, RgbdImage):
        return None
    half_m = PHANTOM_M[0] / 2, PHANTOM_M[1] / 2
    search = partial(find_lying, image, T_camera_floor, half_m, tracker.setup.needle)
    return await hand.compute("perception", LOOKING_OVER_S, search)
