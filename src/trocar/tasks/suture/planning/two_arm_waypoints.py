"""The waypoints of two arms that sew round a circle, for robots; both arms of a stitch share one clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import Suture
from trocar.tasks.suture.planning.pull import grip_segments, out_segments
from trocar.tasks.suture.planning.segments import JAW_CLOSED_RAD, Segment, suture_segments
from trocar.tasks.suture.planning.two_arms import SecondArm, TwoArmPlan
from trocar.tasks.suture.planning.waypoints import COLUMNS, Timeline, Waypoints, rows

PULLING_M_S, TRAVEL_M_S = 0.010, 0.020
"""Mean speeds of the jaws when they pull the needle through, and when they come, go or carry it."""
TWO_ARM_COLUMNS = ("arm", *COLUMNS)
"""Columns of the table of stitches by two arms."""
Pair = tuple[Waypoints, Waypoints]
"""One stitch: the first arm's waypoints, and the second's, on one clock."""


def two_arm_waypoints(sutures: Sequence[Suture], plan: TwoArmPlan, home_q: np.ndarray, second: SecondArm) -> list[Pair]:
    """Return the waypoints of all stitches, from both arms' homes to where the second holds the last needle up.

    The arms take turns: one rests while the other moves. The first alternative of each handover is used. A robot should
    look where the needle is before each grasp, as the simulated arms do: the waypoints say where it should be.

    Args:
        sutures: in order, with the first arm and its base.
        plan: what the arms do between the sutures.
        home_q: (6,) where the first arm rests while the second one moves.
        second: the second arm.
    """
    found, held_q = [], second.home_q
    for number, suture in enumerate(sutures):
        first, other = Timeline(suture.setup.arm, home_q), Timeline(second.model, held_q)
        if number:
            handover = plan.handovers[number - 1][0]
            other.go(handover.part.q[0])
            first.wait(other.now_s)
            _take(first, handover.take)
            other.wait(first.now_s)
            _travel(other, JAW_OPEN_RAD, handover.part)
            other.go(second.home_q)
            first.wait(other.now_s)
        else:
            take, lift = plan.stand
            _take(first, take)
            _travel(first, JAW_CLOSED_RAD, lift)
        *way_in, withdraw, rise = suture_segments(suture)
        first.go(next(segment.q[0] for segment in way_in if len(segment.q)))
        for segment in way_in:
            first.follow(segment)
        one, last = plan.pulls[number].grips
        reach, pull, leave = grip_segments(one)
        again, further, _ = grip_segments(last)
        draw, lift = out_segments(last)
        other.wait(first.now_s)
        _take(other, reach)
        first.wait(other.now_s)
        first.follow(withdraw)
        first.follow(rise)
        first.go(home_q)
        other.wait(first.now_s)
        other.move(pull.name, pull.q, pull.length_m / PULLING_M_S)
        _travel(other, JAW_OPEN_RAD, leave)
        _take(other, again)
        for segment in (further, draw):
            other.move(segment.name, segment.q, segment.length_m / PULLING_M_S)
        _travel(other, JAW_CLOSED_RAD, lift)
        held_q = lift.q[-1]
        found.append((first.waypoints(suture), other.waypoints(suture)))
    return found


def two_arm_rows(arms: Sequence[str], stitches: Sequence[Pair]) -> Iterator[list[str]]:
    """Return the rows of the table of stitches by two arms of these names; time begins anew with each stitch."""
    for number, pair in enumerate(stitches, start=1):
        for arm, one in zip(arms, pair, strict=True):
            yield from ([arm, str(number), *row[1:]] for row in rows([one]))


def _take(timeline: Timeline, segment: Segment) -> None:
    """Go along a segment with open jaws, and close them."""
    timeline.jaw(JAW_OPEN_RAD)
    timeline.go(segment.q[0])
    _travel(timeline, JAW_OPEN_RAD, segment)
    timeline.jaw(JAW_CLOSED_RAD)


def _travel(timeline: Timeline, jaw_rad: float, segment: Segment) -> None:
    """Go along a segment with this opening of the jaws."""
    timeline.jaw(jaw_rad)
    timeline.move(segment.name, segment.q, segment.length_m / TRAVEL_M_S)
