"""The second arm's part of a stitch: it grasps the needle near its tip, pulls it through along its arc, draws it out.

Poses are those of ``primitive``: the needle's rotation counts from where its straight way in ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, ik_unbounded
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3, TURN
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.tasks.suture.planning.clearance import fingers_above_m
from trocar.tasks.suture.planning.primitive import (
    INSERTION,
    ROLL,
    SPACING_M,
    SPACING_RAD,
    Suture,
    needle_poses,
    tip_poses,
    unwound,
)
from trocar.tasks.suture.planning.segments import UP, Segment, ranges, suture_segments
from trocar.tasks.suture.planning.setup import NeedleGrasp, SutureSetup

BEHIND_TIP_RAD = np.radians([8.0, 13.0, 18.0])
APPROACHES_RAD, LEANS_RAD = np.radians(np.arange(-180.0, 180.0, 10.0)), np.radians(np.arange(-90.0, 91.0, 10.0))
"""Grasps that are tried: near enough to the tip to be over the tissue, far enough from it for the jaws to hold."""
DRAWN_RAD = math.radians(45.0)
"""So much of the needle's arc is still in the tissue when it is drawn out straight, .6 mm off its arc at most; if it
were turned further, its tip would come round to the tissue, and the arm near a limit."""
COMES_FROM_M, COMES_DOWN_M = 0.012, 0.020
"""Open jaws come along their own axis from this far back, and there from this far above."""
CLEAR_M, LIFTED_M = 0.004, 0.020
"""How far the needle's tail is drawn beyond the surface, and how far the needle is lifted then."""
OVER_TISSUE_M = 1.0e-3
"""Least height of fingers, wrist and shaft over the tissue."""
APART_M = 4.0e-3
"""Least distance of the two instruments, as a coordinator of arms keeps it."""
OPEN_RAD, HOLDING_RAD = 0.4, 0.1
"""Opening of jaws that come and go, and of jaws on a wire."""
ROOM_RAD, ROOM_M = math.radians(8.0), 4.0e-3
"""Least room of the turning joints and of the insertion to their limits: corrections and the commands of a worn
instrument need some of it."""


@dataclass(frozen=True, eq=False)
class Pull:
    """How the second arm pulls a needle through.

    Attributes:
        suture: with the second arm, its base and its grasp in place of the first arm's.
        turn_rad: the needle's rotation where it is grasped, and where it is no longer turned but drawn out.
        room_rad: least room of the turning joints to their limits, on the whole way.
        apart_m: least distance of the two instruments until the second one has grasped the needle.
    """

    suture: Suture
    turn_rad: tuple[float, float]
    room_rad: float = 0.0
    apart_m: float = 0.0

    @property
    def setup(self) -> SutureSetup:
        """Return the geometry with the second arm."""
        return self.suture.setup


def tail_out_rad(setup: SutureSetup) -> float:
    """Return the needle's rotation at which its tail comes out of the tissue."""
    return setup.exit_turn_rad + setup.needle.arc_rad


def tip_in_again_rad(setup: SutureSetup) -> float:
    """Return the needle's rotation at which its tip, having come round, would go into the tissue again."""
    return TURN - setup.exit_turn_rad + 2.0 * setup.insertion.entry_angle_rad


def with_puller(setup: SutureSetup, arm: ArmModel, T_world_base: SE3, grasp: NeedleGrasp) -> SutureSetup:
    """Return the geometry with the second arm in place of the first."""
    return replace(setup, arm=arm, T_world_base=T_world_base, grasp=grasp)


def plan_pull(suture: Suture, arm: ArmModel, T_world_base: SE3) -> Pull:
    """Return how an arm pulls the needle of a suture through in one grip.

    Of the grasps in which flat jaws hold the wire it is the one that leaves the joints most room, among those that keep
    the instrument out of the tissue and clear of the first arm.

    Args:
        suture: with the first arm, which holds the needle where the second one comes to grasp it.
        arm: the second arm.
        T_world_base: its base.

    Raises:
        OutOfReach: there is no such grasp.
    """
    setup = suture.setup
    turn_rad = (setup.insertion.turn_rad, tail_out_rad(setup) - DRAWN_RAD)
    turns = np.linspace(*turn_rad, 20)
    grasps, in_needle = _grasps(setup.needle.radius_m)
    at_needle = needle_poses(setup, setup.insertion.straight_m, turns).matrix[suture.row]
    poses = SE3.unchecked(at_needle @ in_needle[:, None])
    clear = np.flatnonzero((fingers_above_m(arm, poses) > OVER_TISSUE_M).all(1))
    any_grasp = with_puller(setup, arm, T_world_base, grasps[0])
    T_base_theta = any_grasp.T_base_circle @ SE3.from_parts(SO3.axis("z", suture.theta_rad))
    q = ik_unbounded(arm, T_base_theta @ SE3.unchecked(poses.matrix[clear]))
    room = np.where((over_tissue_m(any_grasp, q) > OVER_TISSUE_M).all(1), room_rad(arm, q).min(1), 0.0)
    first = holding_still(suture)
    best = Pull(suture, turn_rad)
    for k in np.argsort(-room):
        if room[k] <= max(ROOM_RAD, best.room_rad):
            break
        pull = Pull(replace(suture, setup=replace(any_grasp, grasp=grasps[clear[k]])), turn_rad)
        ways = pull_segments(pull)
        apart = capsule_distances_m(capsules(arm, ways[0].q, OPEN_RAD).moved(T_world_base), first).min()
        path = np.concatenate([way.q for way in ways])
        least = float(room_rad(arm, path).min())
        if apart >= APART_M and over_tissue_m(pull.setup, path).min() > OVER_TISSUE_M and least > best.room_rad:
            best = replace(pull, room_rad=least, apart_m=float(apart))
    if best.room_rad < ROOM_RAD:
        raise OutOfReach(f"the second arm cannot pull the needle through at {suture} in one grip; place it elsewhere")
    return best


@lru_cache(maxsize=4)
def _grasps(needle_radius_m: float) -> tuple[list[NeedleGrasp], NDArray[np.float64]]:
    """Return the grasps that are tried (n), and the tip's pose (n, 4, 4) in the needle's frame in each."""
    grasps = [NeedleGrasp(*map(float, values)) for values in product(BEHIND_TIP_RAD, APPROACHES_RAD, LEANS_RAD)]
    return grasps, np.stack([grasp.pose(needle_radius_m).matrix for grasp in grasps])


def holding_still(suture: Suture) -> Capsules:
    """Return the first arm's instrument in the world as it holds the needle at the end of a suture."""
    setup = suture.setup
    driven = [way for way in suture_segments(suture) if way.name.startswith(("push", "rotate"))]
    return capsules(setup.arm, driven[-1].q[-1], HOLDING_RAD).moved(setup.T_world_base)


def pull_segments(pull: Pull) -> tuple[Segment, ...]:
    """Return the second arm's segments: ``reach``, ``pull``, ``draw``, ``lift``; the roll is continuous over them.

    In the first the jaws are open, in the others they hold the needle.
    """
    setup, suture = pull.setup, pull.suture
    arc_rad = pull.turn_rad[1] - pull.turn_rad[0]
    turns = np.linspace(*pull.turn_rad, 2 + math.floor(arc_rad / SPACING_RAD))
    turned = suture.turned(tip_poses(setup, setup.insertion.straight_m, turns))
    back = turned[0].matrix[:3, 2]  # the jaws point the other way
    down = shifted(turned[0], COMES_FROM_M * back + COMES_DOWN_M * UP, COMES_FROM_M * back)
    along = shifted(turned[0], COMES_FROM_M * back, np.zeros(3))
    reach = SE3.unchecked(np.concatenate([down.matrix[:-1], along.matrix]))
    out_m = drawn_out_m(pull)
    draw = shifted(turned[-1], np.zeros(3), out_m)
    lift = shifted(draw[-1], np.zeros(3), LIFTED_M * UP)
    parts: tuple[tuple[str, SE3, float], ...] = (
        ("reach", reach, COMES_FROM_M + COMES_DOWN_M),
        ("pull", turned, setup.needle.radius_m * arc_rad),
        ("draw", draw, float(np.linalg.norm(out_m))),
        ("lift", lift, LIFTED_M),
    )
    names, poses, lengths = zip(*parts, strict=True)
    q = ik_unbounded(setup.arm, setup.T_base_circle @ SE3.unchecked(np.concatenate([T.matrix for T in poses])))
    q[:, ROLL] = unwound(q[:, ROLL], setup.arm.middle_floats[ROLL])
    ends = np.cumsum([len(T.matrix) for T in poses])
    return tuple(Segment(*each) for each in zip(names, np.split(q, ends[:-1]), lengths, strict=True))


def drawn_out_m(pull: Pull) -> NDArray[np.float64]:
    """Return the way (3,), in the circle's frame, on which the needle is drawn out: along the chord of what is in."""
    setup = pull.setup
    turns = np.array([pull.turn_rad[1], tail_out_rad(setup)])
    T_circle_needle = pull.suture.turned(needle_poses(setup, setup.insertion.straight_m, turns))
    now, out = T_circle_needle.apply(setup.needle.point_m(np.array([setup.needle.arc_rad])))
    chord = out - now
    return chord * (1.0 + CLEAR_M / float(np.linalg.norm(chord)))


def room_rad(arm: ArmModel, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the room (..., k) of the turning joints to their limits along ways (..., k, 6).

    It is 0 where no joints lead there, or the insertion has less than ``ROOM_M``.
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


def shifted(T: SE3, start_m: NDArray[np.float64], end_m: NDArray[np.float64]) -> SE3:
    """Return a pose shifted from one place (3,) to another, straight: (k,)."""
    count = 2 + math.floor(float(np.linalg.norm(end_m - start_m)) / (2 * SPACING_M))
    return SE3.from_parts(T.rotation, T.translation_m + np.linspace(start_m, end_m, count))
