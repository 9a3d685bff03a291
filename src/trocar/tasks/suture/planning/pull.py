"""The second arm's part of a stitch: it grasps the needle near its tip, pulls it through along its arc, draws it out.

Poses are those of ``primitive``: the needle's rotation counts from the end of the straight penetration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, ik_unbounded
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3, TURN
from trocar.geometry.capsules import Capsules, capsule_distances_m, segment_distances_m
from trocar.tasks.suture.needle import Needle
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD, OFF_WALL_M, fingers_above_m
from trocar.tasks.suture.planning.primitive import (
    INSERTION,
    ROLL,
    SPACING_M,
    SPACING_RAD,
    Suture,
    needle_poses,
    unwound,
)
from trocar.tasks.suture.planning.segments import UP, Segment, ranges, suture_segments
from trocar.tasks.suture.planning.setup import NeedleGrasp, SutureSetup

BEHIND_TIP_RAD = (tuple(np.radians([13.0, 18.0])), tuple(np.radians([25.0, 32.0])))
"""Arcs behind the needle's tip at which the first and the second grip are tried. At first, little of the needle is out;
later, jaws that close a millimetre or two aside still hold the wire."""
APPROACHES_RAD, LEANS_RAD = np.radians(np.arange(-180.0, 180.0, 10.0)), np.radians(np.arange(-30.0, 31.0, 10.0))
"""Grasps that are tried: jaws that lean further along the wire leave the other arm less room at the handover."""
DEEP_M = 1.0e-3
"""The wire lies this much deeper in the jaws than the arm's tip. The jaws end only .7 mm beyond the arm's tip, and come
half a millimetre or more aside."""
JAWS_M, HELD_RAD = 0.020, math.radians(30.0)
"""This much of the instrument, from the tip of its jaws back, has to stay clear of the wire, except for this arc on
either side of the grasp."""
FREE_M = 4.0e-3
"""Least distance of the jaws' centreline from the rest of the wire: the jaws are open when they come and go."""
DRAWN_RAD = math.radians(45.0)
"""This arc of the needle is still in the tissue when the needle is drawn out straight, at most .6 mm off its arc. If
the needle were turned further, its tip would come round to the tissue."""
SHARES = (0.4, 0.5, 0.6)
"""Shares of the rotation at which a second grip is tried, while the tissue holds the needle."""
COMES_FROM_M, COMES_DOWN_M = 0.010, 0.010
"""Open jaws come along their own axis from this far back; to that place they come from this far above."""
CLEAR_M, LIFTED_M = 0.004, 0.020
"""How far the needle's tail is drawn beyond the surface, and how far the needle is lifted then."""
OVER_TISSUE_M = 1.0e-3
"""Least height of fingers, wrist and shaft over the tissue."""
HOLDING_RAD = 0.1
"""Opening of jaws on a wire."""
SAMPLES = 24
"""Number of configurations at which a motion from rest to rest is checked."""
ROOM_RAD, ROOM_M = math.radians(8.0), 4.0e-3
"""Least room of the rotary joints and of the insertion to their limits: corrections and the commands of a worn
instrument need some of it, up to 30 deg at the wrist."""


@dataclass(frozen=True)
class DeepGrasp(NeedleGrasp):
    """A grasp in which the wire lies further in the jaws than the arm's tip."""

    def pose(self, needle_radius_m: float) -> SE3:
        """Return the pose of the arm's tip in the frame of a needle of this radius."""
        return super().pose(needle_radius_m) @ SE3.from_parts(translation_m=[0.0, 0.0, -DEEP_M])


@dataclass(frozen=True, eq=False)
class Grip:
    """One of the second arm's grips of the needle.

    Attributes:
        suture: the suture, with the second arm, its base and its grasp in place of the first arm's.
        turn_rad: the needle's rotation where it is grasped, and where this grip ends.
        room_rad: least room of the rotary joints to their limits, from the approach to the end of the grip.
    """

    suture: Suture
    turn_rad: tuple[float, float]
    room_rad: float

    @property
    def setup(self) -> SutureSetup:
        """Return the geometry with the second arm."""
        return self.suture.setup

    def T_circle_needle(self, turns_rad: NDArray[np.float64]) -> SE3:
        """Return where the needle is after these rotations (n,)."""
        return self.suture.turned(needle_poses(self.setup, self.setup.insertion.straight_m, turns_rad))


@dataclass(frozen=True, eq=False)
class Pull:
    """How the second arm pulls a needle through, in two grips.

    Attributes:
        grips: in order.
        apart_m: least distance of the two instruments, while the second one comes and then the first one leaves.
    """

    grips: tuple[Grip, Grip]
    apart_m: float

    @property
    def room_rad(self) -> float:
        """Return the least room of the rotary joints to their limits."""
        return min(grip.room_rad for grip in self.grips)


def tail_out_rad(setup: SutureSetup) -> float:
    """Return the needle's rotation at which its tail comes out of the tissue."""
    return setup.exit_turn_rad + setup.needle.arc_rad


def plan_pull(
    suture: Suture,
    arm: ArmModel,
    T_world_base: SE3,
    first_home_q: NDArray[np.float64],
    worth: Callable[[SutureSetup], float] | None = None,
) -> Pull:
    """Return how an arm pulls the needle of a suture through.

    Of the grasps that flat jaws can hold, and that keep the instrument out of the tissue and, in the first grip, clear
    of the first arm, those are chosen that leave the joints the most room.

    Args:
        suture: the suture with the first arm, which holds the needle while the second one comes to grasp it.
        arm: the second arm.
        T_world_base: pose of its base.
        first_home_q: (6,) where the first arm goes when it has let go.
        worth: returns the joints' room, rad, in what follows the second grip; None: nothing follows.

    Raises:
        OutOfReach: there are no such grasps.
    """
    mine = replace(suture, setup=replace(suture.setup, arm=arm, T_world_base=T_world_base))
    start, end = mine.setup.insertion.turn_rad, tail_out_rad(mine.setup) - DRAWN_RAD
    holds, leaves, best = holding_still(suture), _going_home(suture, first_home_q), None
    for share in SHARES:
        middle = start + share * (end - start)
        parts = zip(((start, middle), (middle, end)), BEHIND_TIP_RAD, strict=True)
        grips = [next(_grips(mine, *part), None) for part in parts]
        room = min(grip.room_rad if grip else 0.0 for grip in grips)
        if room > ROOM_RAD and (best is None or room > best[0]):
            best = room, middle
    if best is not None:
        grips = _grips(mine, (start, best[1]), BEHIND_TIP_RAD[0])
        one = next((grip for grip in grips if _apart_m(grip, holds, leaves) >= APART_M), None)
        if one:
            two = _preferred(_grips(mine, (best[1], end), BEHIND_TIP_RAD[1]), worth)
            return Pull((one, two), _apart_m(one, holds, leaves))
    raise OutOfReach(f"the second arm cannot pull the needle through at {suture}; place it elsewhere")


def _preferred(grips: Iterator[Grip], worth: Callable[[SutureSetup], float] | None) -> Grip:
    """Return the grip with the most room, in itself and in what follows; ``grips`` come with decreasing own room."""

    def whole_room_rad(grip: Grip) -> float:
        return grip.room_rad if worth is None else min(grip.room_rad, worth(grip.setup))

    found = next(grips)
    best = whole_room_rad(found)
    for grip in grips:
        if grip.room_rad <= best:
            break
        if (room := whole_room_rad(grip)) > best:
            best, found = room, grip
    return found


def _grips(mine: Suture, turn_rad: tuple[float, float], behind_tip_rad: tuple[float, ...]) -> Iterator[Grip]:
    """Yield grips with enough room over a part of the needle's rotation, the one with most room first.

    ``mine`` is the suture with the second arm, in any grasp.
    """
    setup, arm = mine.setup, mine.setup.arm
    grasps, in_needle = _grasps(setup.needle, behind_tip_rad)
    at_needle = needle_poses(setup, setup.insertion.straight_m, np.linspace(*turn_rad, 12)).matrix[mine.row]
    opened = np.isin(np.arange(12), (0, 11))
    poses = at_needle @ in_needle[:, None]
    places = np.flatnonzero((fingers_above_m(arm, SE3.unchecked(poses), opened) > OVER_TISSUE_M).all(1))
    if not len(places):
        return
    poses = poses[places]
    # the approach, from above and then along the jaws' axis, and the way back
    back = poses[:, [0, 0, -1, -1]]
    back[:, :, :3, 3] += COMES_FROM_M * back[:, :, :3, 2]
    back[:, 0, 2, 3] += COMES_DOWN_M
    back[:, 3, 2, 3] += COMES_DOWN_M
    T_base_theta = setup.T_base_circle @ SE3.from_parts(SO3.axis("z", mine.theta_rad))
    q = ik_unbounded(arm, T_base_theta @ SE3.unchecked(np.concatenate([back[:, :2], poses, back[:, 2:]], axis=1)))
    free = (over_tissue_m(setup, q) > OVER_TISSUE_M) & (wrist_inside_m(setup, q) > 0.0)
    room = np.where(free.all(1), room_rad(arm, q).min(1), 0.0)
    for k in np.argsort(-room):
        if room[k] < ROOM_RAD:
            return
        yield Grip(replace(mine, setup=replace(setup, grasp=grasps[places[k]])), turn_rad, float(room[k]))


def _apart_m(grip: Grip, holds: Capsules, leaves: Capsules) -> float:
    """Return the least distance of the two instruments: while the second arm comes, and while the first one leaves."""
    reach = reach_segment(grip).q
    coming = capsules(grip.setup.arm, reach, JAW_OPEN_RAD).moved(grip.setup.T_world_base)
    waiting = capsules(grip.setup.arm, reach[-1], HOLDING_RAD).moved(grip.setup.T_world_base)
    return min(float(capsule_distances_m(a, b).min()) for a, b in ((coming, holds), (leaves, waiting)))


def _going_home(suture: Suture, home_q: NDArray[np.float64]) -> Capsules:
    """Return the first arm's instrument in the world on its way from the end of a suture home."""
    *_, driven, withdraw, rise = suture_segments(suture)
    path = np.concatenate([driven.q[-1:], withdraw.q, rise.q])
    path = np.concatenate([path, np.linspace(path[-1], home_q, SAMPLES)])
    return capsules(suture.setup.arm, path, JAW_OPEN_RAD).moved(suture.setup.T_world_base)


@lru_cache(maxsize=4)
def _grasps(needle: Needle, behind_tip_rad: tuple[float, ...]) -> tuple[list[DeepGrasp], NDArray[np.float64]]:
    """Return the grasps (n) in which the jaws come and go clear of the rest of the wire.

    With them come the tip's poses (n, 4, 4) in the needle's frame.
    """
    angles = product(behind_tip_rad, APPROACHES_RAD, LEANS_RAD)
    grasps = [DeepGrasp(*map(float, values)) for values in angles]
    poses = np.stack([grasp.pose(needle.radius_m).matrix for grasp in grasps])
    tip, wrist = poses[:, :3, 3], poses[:, :3, 3] + JAWS_M * poses[:, :3, 2]
    free = []
    for k, grasp in enumerate(grasps):
        wire = wire_capsules(needle, grasp.behind_tip_rad).ends_m
        apart_m = segment_distances_m(tip[k], wrist[k], wire[:, 0], wire[:, 1]).min()
        free.append(apart_m > FREE_M)
    return [grasp for grasp, good in zip(grasps, free, strict=True) if good], poses[free]


def wire_capsules(needle: Needle, grasped_rad: float) -> Capsules:
    """Return the wire in the needle's frame, except near where jaws hold it, this far behind its tip."""
    at = np.linspace(0.0, needle.arc_rad, 1 + math.ceil(needle.arc_rad / math.radians(7.5)))
    ends = np.stack([needle.point_m(at[:-1]), needle.point_m(at[1:])], axis=1)
    ends = ends[np.abs(0.5 * (at[:-1] + at[1:]) - grasped_rad) > HELD_RAD]
    return Capsules(ends, np.full(len(ends), needle.wire_m / 2))


def holding_still(suture: Suture) -> Capsules:
    """Return the first arm's instrument in the world as it holds the needle at the end of a suture."""
    setup = suture.setup
    driven = [way for way in suture_segments(suture) if way.name.startswith(("push", "rotate"))]
    return capsules(setup.arm, driven[-1].q[-1], HOLDING_RAD).moved(setup.T_world_base)


def reach_segment(grip: Grip) -> Segment:
    """Return the path of open jaws to a grip: down, and then along their own axis."""
    return grip_segments(grip)[0]


def grip_segments(grip: Grip) -> tuple[Segment, ...]:
    """Return the segments of one grip: ``reach``, ``pull``, and ``leave`` with open jaws; the roll is continuous."""
    setup = grip.setup
    arc_rad = grip.turn_rad[1] - grip.turn_rad[0]
    turned = grip.T_circle_needle(np.linspace(*grip.turn_rad, 2 + math.floor(arc_rad / SPACING_RAD)))
    turned = turned @ setup.grasp.pose(setup.needle.radius_m)
    ways = [_leaving(turned[0])[::-1], turned, _leaving(turned[-1])]
    away_m = COMES_FROM_M + COMES_DOWN_M
    return _segments(setup, ("reach", "pull", "leave"), ways, (away_m, setup.needle.radius_m * arc_rad, away_m))


def out_segments(grip: Grip) -> tuple[Segment, ...]:
    """Return the segments that end the last grip: ``draw`` the needle out of the tissue, and ``lift`` it."""
    setup, out_m = grip.setup, drawn_out_m(grip)
    last = (grip.T_circle_needle(np.array([grip.turn_rad[1]])) @ setup.grasp.pose(setup.needle.radius_m))[0]
    draw = shifted(last, np.zeros(3), out_m)
    lift = shifted(draw[-1], np.zeros(3), LIFTED_M * UP)
    near = grip_segments(grip)[1].q[-1]
    return _segments(setup, ("draw", "lift"), [draw, lift], (float(np.linalg.norm(out_m)), LIFTED_M), near)


def _segments(
    setup: SutureSetup,
    names: Sequence[str],
    ways: Sequence[SE3],
    lengths_m: Sequence[float],
    near: NDArray[np.float64] | None = None,
) -> tuple[Segment, ...]:
    """Return successive paths of the tip in the circle's frame as segments, the roll continuous over them."""
    poses = SE3.unchecked(np.concatenate([way.matrix for way in ways]))
    q = ik_unbounded(setup.arm, setup.T_base_circle @ poses)
    q[:, ROLL] = unwound(q[:, ROLL], setup.arm.middle_floats[ROLL])
    if near is not None:
        q[:, ROLL] -= TURN * np.rint((q[0, ROLL] - near[ROLL]) / TURN)
    ends = np.cumsum([len(way.matrix) for way in ways])
    parts = zip(names, np.split(q, ends[:-1]), lengths_m, strict=True)
    return tuple(Segment(*part) for part in parts)


def _leaving(T_circle_tip: SE3) -> SE3:
    """Return the poses of open jaws that leave a needle: back along their own axis, then up."""
    back = COMES_FROM_M * T_circle_tip.matrix[:3, 2]  # the jaws point the other way
    out = shifted(T_circle_tip, np.zeros(3), back)
    up = shifted(T_circle_tip, back, back + COMES_DOWN_M * UP)
    return SE3.unchecked(np.concatenate([out.matrix, up.matrix[1:]]))


def drawn_out_m(grip: Grip) -> NDArray[np.float64]:
    """Return the shift (3,) in the circle's frame that draws the needle out, along the chord of its arc inside."""
    turns = np.array([grip.turn_rad[1], tail_out_rad(grip.setup)])
    now, out = grip.T_circle_needle(turns).apply(grip.setup.needle.point_m(np.array([grip.setup.needle.arc_rad])))
    chord = out - now
    return chord * (1.0 + CLEAR_M / float(np.linalg.norm(chord)))


def room_rad(arm: ArmModel, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the room (..., k) of the rotary joints to their limits along paths (..., k, 6).

    It is 0 where the arm has no solution, or the insertion has no more room than ``ROOM_M``.
    """
    q = q.copy()
    q[..., ROLL] = unwound(q[..., ROLL], arm.middle_floats[ROLL])
    lower, upper = ranges(arm)
    room = np.minimum(q - lower, upper - q)
    turning = room[..., np.arange(6) != INSERTION].min(-1)
    return np.where(np.isfinite(turning) & (room[..., INSERTION] > ROOM_M), turning, 0.0)


def over_tissue_m(setup: SutureSetup, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height (...,) of shaft and wrist over the tissue's plane at joints (..., 6)."""
    solids = capsules(setup.arm, q).moved(setup.T_base_circle.inverse())
    return (solids.ends_m[..., :2, :, 2].min(-1) - solids.radii_m[:2]).min(-1)


def wrist_inside_m(setup: SutureSetup, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the wrist's clearance (...,) from the body wall, less the required one; infinite without a wall."""
    if not setup.wall.up_m:
        return np.full(q.shape[:-1], np.inf)
    solids = capsules(setup.arm, q).moved(setup.T_world_base)
    over_m = (solids.ends_m[..., 1, :, :] - [0.0, 0.0, setup.wall.up_m]) @ setup.wall.normal
    return -over_m.max(-1) - solids.radii_m[1] - OFF_WALL_M


def shifted(T: SE3, start_m: NDArray[np.float64], end_m: NDArray[np.float64]) -> SE3:
    """Return poses (k,): a pose moved straight from one shift (3,) to another."""
    count = 2 + math.floor(float(np.linalg.norm(end_m - start_m)) / (2 * SPACING_M))
    return SE3.from_parts(T.rotation, T.translation_m + np.linspace(start_m, end_m, count))
