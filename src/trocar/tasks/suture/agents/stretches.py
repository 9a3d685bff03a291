"""The path of a suture divided where the camera looks at the needle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from trocar.tasks.suture.planning.primitive import driven_steps
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.planning.setup import SutureSetup

BEFORE_ENTRY_M = 2e-3
"""Distance of the last look before the tissue, along the needle's path."""
PAST_ENTRY_M = 2.5e-3
"""From there the tip goes in this far without a pause, with the wrist at rest, because cables that reverse would move
it just at the entry. Also, the unrepeatable errors change within a second: the sooner the tip is there, the better what
was seen still holds."""
BEFORE_EXIT_RAD = np.radians(8.0)
"""Angle of the last look before the tip comes out, about the needle's centre."""
WELL_BEFORE_EXIT_RAD = np.radians(16.0)
"""Another look is taken there, because after the jaws have closed elsewhere, cable errors may bring the tip out
early."""
HIGH_LOOKS, ENTRY_LOOKS, EXIT_LOOKS = 2, 4, 3
"""Greatest number of looks above the tissue, just before the needle goes in, and just before it comes out."""


class Aim(Enum):
    """What a correction before a stretch of the path applies to."""

    POSE = "position and attitude"
    TIP = (
        "the position of the needle's tip alone, by the outer joints: turning the wrist again would reverse its cables"
    )


@dataclass(frozen=True)
class Stretch:
    """A part of the path without a look.

    Attributes:
        segment: to be followed.
        first: whether it is the first of its step.
        looks: maximum number of looks at the needle before it. If more than one is allowed, the arm goes to the
            stretch's corrected start after each; otherwise it joins the corrected path on the way.
        aim: what is corrected.
        fixed_wrist: whether the wrist does not move at all.
    """

    segment: Segment
    first: bool = True
    looks: int = 0
    aim: Aim = Aim.POSE
    fixed_wrist: bool = False


def stretches(segments: Sequence[Segment], setup: SutureSetup) -> list[Stretch]:
    """Return the path divided at the looks: above and before the entry, in each grip, before the exit.

    The arm does not stop at the surface, neither on the way in nor on the way out: when it starts again, reversed
    cables take up their play, and that would be just where the position of the needle's tip counts.
    """
    exit_rad = setup.exit_turn_rad
    steps = {step.name: step for step in driven_steps(setup)}
    found: list[Stretch] = []
    for segment in segments:
        step = steps.get(segment.name)
        if segment.name == "approach":
            share = 1.0 - BEFORE_ENTRY_M / max(segment.length_m, BEFORE_ENTRY_M)
            found += _cut(Stretch(segment, looks=HIGH_LOOKS), share, ENTRY_LOOKS)
        elif step is None or segment.name == "penetrate":
            found.append(Stretch(segment))
        elif step.holds:
            start, end = step.needle_rad
            whole = Stretch(segment, looks=0 if segment.name == "rotate" or start > exit_rad else 1)
            last = exit_rad - BEFORE_EXIT_RAD
            before, *after = _cut(whole, (last - start) / (end - start), EXIT_LOOKS)
            if after:
                after = [*_cut(before, (exit_rad - WELL_BEFORE_EXIT_RAD - start) / (last - start), 1), *after]
            found += after or [before]
        else:
            found.append(Stretch(segment, looks=1 if step.needle_rad[0] < exit_rad else 0))
    return _joined_at_entry(found)


def _cut(whole: Stretch, share: float, looks: int) -> list[Stretch]:
    """Return a stretch divided at a share of its length, with the last looks in between; whole if it ends before."""
    segment = whole.segment
    steps = len(segment.q) - 1
    place = round(share * steps) if np.isfinite(share) else 0
    if not 0 < place < steps:
        return [whole]
    before = replace(segment, q=segment.q[: place + 1], length_m=segment.length_m * place / steps)
    after = replace(segment, q=segment.q[place:], length_m=segment.length_m - before.length_m)
    return [replace(whole, segment=before), Stretch(after, first=False, looks=looks, aim=Aim.TIP)]


def _joined_at_entry(found: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches with the rest of the approach after the last looks and the tip's entry joined."""
    joined: list[Stretch] = []
    for stretch in found:
        last = joined[-1] if joined else stretch
        if stretch.segment.name != "penetrate" or last.aim is not Aim.TIP:
            joined.append(stretch)
            continue
        whole, steps = stretch.segment, len(stretch.segment.q) - 1
        deep = min(steps, max(1, round(PAST_ENTRY_M / max(whole.length_m, PAST_ENTRY_M) * steps)))
        deep_m = whole.length_m * deep / steps
        q = np.concatenate([last.segment.q, whole.q[1 : deep + 1]])
        way = replace(whole, q=q, length_m=last.segment.length_m + deep_m)
        joined[-1] = replace(last, segment=way, first=True, fixed_wrist=True)
        if deep < steps:
            left = replace(whole, q=whole.q[deep:], length_m=whole.length_m - deep_m)
            joined.append(Stretch(left, first=False, aim=Aim.TIP))
    return joined
