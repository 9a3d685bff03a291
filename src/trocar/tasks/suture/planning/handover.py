"""Plan where one arm hands the needle to the other in the air, in the grasp that the next stitch needs."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.arms import capsules, ik_unbounded
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.geometry.capsules import capsule_distances_m
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import INSERTION, ROLL, grasp_pose, unwound
from trocar.tasks.suture.planning.pull import (
    COMES_FROM_M,
    HOLDING_RAD,
    ROOM_RAD,
    SAMPLES,
    over_tissue_m,
    room_rad,
    shifted,
    wire_capsules,
    wrist_inside_m,
)
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.planning.setup import SutureSetup

HEIGHTS_M = (0.030, 0.040, 0.050)
"""Heights of the needle's centre over the tissue that are tried: instruments have to reach round it."""
BEHIND = (-0.6, 0.0, 0.6)
"""Points of the tissue, in x and y of the circle as shares of its radius, that the camera sees behind the needle's
centre. Perception needs tissue behind the needle, because it tells the needle by its colour."""
ATTITUDES, SEED = 1500, 7
"""Number of attitudes of the needle that are tried at each place, and the seed that draws them."""
FACES = 0.45
"""Least |cosine| of the angle between the normal of the needle's plane and the direction to the camera."""
TRIED, ENOUGH_ROOM_RAD, TURN_COSTS = 300, math.radians(40.0), 0.04
"""Number of places, those with the most room, that are considered; room above which more is not better; and room that
the giver's largest joint rotation on its way there costs, in rad per rad, because it takes time."""
WIRE_APART_M = 1.0e-3
"""Least distance of a moving instrument from the wire, except near its own grasp."""
ALTERNATIVES, OTHERWISE_RAD = 4, math.radians(25.0)
"""Maximum number of handovers, and the least rotation between the needle's attitudes in them."""
TOO_LITTLE_ROOM = f"an arm's joints would come within {math.degrees(ROOM_RAD):.0f} deg of their limits, or beyond them"


@dataclass(frozen=True, eq=False)
class Holder:
    """One arm of a handover.

    Attributes:
        setup: the geometry with this arm, and its grasp.
        home_q: (6,) joints at rest, from where the taker comes, and to where the giver goes.
        start_q: (6,) joints at which the giver begins to bring the needle; for the taker, its home.
    """

    setup: SutureSetup
    home_q: NDArray[np.float64]
    start_q: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Handover:
    """How a needle changes hands.

    Attributes:
        T_circle_needle: where the needle is held still meanwhile.
        take: path of the taking arm to its grasp, along its jaws' own axis.
        part: path of the giving arm away from its grasp, likewise; at its first joints it holds the needle.
        room_rad: least room of both arms' rotary joints to their limits.
        apart_m: least distance of the two instruments, from the taker's home to its grasp and back to the giver's home.
    """

    T_circle_needle: SE3
    take: Segment
    part: Segment
    room_rad: float = 0.0
    apart_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Places:
    """Where the taker reaches a needle that the camera sees well.

    Attributes:
        T_circle_needle: (n,) poses of the needle.
        room_rad: (n,) room of the taker's rotary joints to their limits.
    """

    T_circle_needle: SE3
    room_rad: NDArray[np.float64]

    def both_rad(self, giver: SutureSetup) -> NDArray[np.float64]:
        """Return the room (n,) of both arms' rotary joints to their limits."""
        return np.minimum(self.room_rad, _room_at(giver, self.T_circle_needle))


def handover_places(taker: SutureSetup, p_circle_camera_m: NDArray[np.float64]) -> Places:
    """Return where an arm could take a needle in the grasp of its setup.

    Args:
        taker: the geometry with this arm.
        p_circle_camera_m: (3,) position, in the circle's frame, of the camera that has to see the needle.

    Raises:
        OutOfReach: there is no such place.
    """
    rng = np.random.default_rng(SEED)
    attitudes = SO3.from_quaternion(_unit(rng.standard_normal((ATTITUDES, 4)))).matrix
    poses = []
    for x, y, up_m in product(BEHIND, BEHIND, HEIGHTS_M):
        behind = taker.circle.radius_m * np.array([x, y, 0.0])
        # on the line of sight to that point of the tissue, at this height
        place = behind + (p_circle_camera_m - behind) * up_m / p_circle_camera_m[2]
        sight = p_circle_camera_m - place
        facing = attitudes[np.abs(attitudes[:, :, 2] @ sight) > FACES * np.linalg.norm(sight)]
        poses.append(SE3.from_parts(SO3.unchecked(facing), np.broadcast_to(place, (len(facing), 3))).matrix)
    T_circle_needle = SE3.unchecked(np.concatenate(poses))
    room = _room_at(taker, T_circle_needle)
    reached = room > ROOM_RAD
    if not reached.any():
        raise OutOfReach("nowhere over the circle can the first arm take the needle; place the arms elsewhere")
    return Places(SE3.unchecked(T_circle_needle.matrix[reached]), room[reached])


def plan_handovers(giver: Holder, taker: Holder, places: Places) -> tuple[Handover, ...]:
    """Return handovers, the best first: it leaves both arms' joints enough room, and turns the giver's joints least.

    The others are alternatives, with other attitudes of the needle, for arms whose commands do not reach the first.

    Args:
        giver: the arm that has the needle.
        taker: the arm that takes it in the grasp of its setup.
        places: where the taker could take it.

    Raises:
        OutOfReach: there is no handover in which both arms reach the needle and stay clear of each other; the message
            says what is most often in the way.
    """
    rooms = places.both_rad(giver.setup)
    likely = np.argsort(-rooms)[:TRIED]
    worth = np.minimum(rooms[likely], ENOUGH_ROOM_RAD)
    worth -= TURN_COSTS * np.array([_turned_rad(giver, places.T_circle_needle[int(k)]) for k in likely])
    chosen: list[Handover] = []
    refused: Counter[str] = Counter()
    for k in likely[np.argsort(-worth)]:
        if len(chosen) == ALTERNATIVES or rooms[k] < ROOM_RAD:
            break
        pose = places.T_circle_needle[int(k)]
        others = [pose.rotation.inverse() @ other.T_circle_needle.rotation for other in chosen]
        if all(np.linalg.norm(turn.log()) > OTHERWISE_RAD for turn in others):
            found = _judged(giver, taker, pose)
            if isinstance(found, Handover):
                chosen.append(found)
            else:
                refused[found] += 1
    if not chosen:
        where = "nowhere over the circle can one arm hand the needle to the other"
        why = refused.most_common(1)[0][0] if refused else f"{TOO_LITTLE_ROOM}; place the arms elsewhere"
        raise OutOfReach(f"{where}: {why}")
    return tuple(chosen)


def taking(setup: SutureSetup, T_circle_needle: SE3, near: NDArray[np.float64] | None = None) -> Segment:
    """Return the path of open jaws, along their own axis, to their grasp of a needle that rests here.

    The roll has the winding nearest to joints ``near`` (6,), if the path then keeps ``ROOM_RAD`` to its limits.
    """
    T_circle_tip = T_circle_needle @ grasp_pose(setup)
    back = COMES_FROM_M * T_circle_tip.matrix[:3, 2]  # the jaws point the other way
    q = ik_unbounded(setup.arm, setup.T_base_circle @ shifted(T_circle_tip, back, np.zeros(3)))
    q[:, ROLL] = unwound(q[:, ROLL], setup.arm.middle_floats[ROLL])
    if near is not None:
        turned = q - setup.arm.turns * np.rint((q - near) / TURN)[-1]
        lower, upper = setup.arm.lower + ROOM_RAD, setup.arm.upper - ROOM_RAD
        if ((turned[:, ROLL] > lower[ROLL]) & (turned[:, ROLL] < upper[ROLL])).all():
            q[:, ROLL] = turned[:, ROLL]
    return Segment("take", q, COMES_FROM_M)


def parting(setup: SutureSetup, T_circle_needle: SE3, near: NDArray[np.float64] | None = None) -> Segment:
    """Return the path of open jaws back from their grasp of a needle that rests here; arguments as for ``taking``."""
    take = taking(setup, T_circle_needle, near)
    return Segment("part", take.q[::-1], take.length_m)


def between(q0: NDArray[np.float64], q1: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return joints (k, 6) along a straight motion in joint space."""
    return np.linspace(q0, q1, SAMPLES)


def _judged(giver: Holder, taker: Holder, T_circle_needle: SE3) -> Handover | str:
    """Return the handover of a needle that rests here, or what is in its way, in words.

    While one arm moves, the other rests with its jaws on the wire.
    """
    take = taking(taker.setup, T_circle_needle, taker.start_q)
    part = parting(giver.setup, T_circle_needle, giver.start_q)
    reached = np.isfinite(take.q).all() and np.isfinite(part.q).all()
    ways = ((taker, take), (giver, part))
    room = min(float(room_rad(each.setup.arm, way.q).min()) for each, way in ways) if reached else 0.0
    if room < ROOM_RAD:
        return f"{TOO_LITTLE_ROOM}; place the arms elsewhere"
    if min(float(wrist_inside_m(each.setup, way.q).min()) for each, way in ways) < 0.0:
        return "a wrist would meet the body wall; raise the wall (wall_up_mm) or place the arms elsewhere"
    apart_m = math.inf
    moves = (
        (taker, giver, np.concatenate([between(taker.home_q, take.q[0]), take.q]), part.q[0]),
        (giver, taker, np.concatenate([part.q, between(part.q[-1], giver.home_q)]), take.q[-1]),
    )
    for mover, still, path, at in moves:
        solids = capsules(mover.setup.arm, path, JAW_OPEN_RAD).moved(mover.setup.T_world_base)
        others = capsules(still.setup.arm, at, HOLDING_RAD).moved(still.setup.T_world_base)
        apart_m = min(apart_m, float(capsule_distances_m(solids, others).min()))
        grasped = mover.setup.grasp.behind_tip_rad
        T_world_needle = mover.setup.circle.T_world_circle @ T_circle_needle
        wire = wire_capsules(mover.setup.needle, grasped).moved(T_world_needle)
        if capsule_distances_m(solids, wire).min() < WIRE_APART_M:
            return "open jaws would meet the wire beside their grasp; let them lean less (grasp_lean_deg)"
        if over_tissue_m(mover.setup, path).min() < 0.0:
            return "an instrument would meet the tissue; place the arms elsewhere"
    if apart_m < APART_M:
        return f"the instruments would come within {shown(APART_M, 'm', '.0f')} of each other; place the arms elsewhere"
    return Handover(T_circle_needle, take, part, room, apart_m)


def _turned_rad(giver: Holder, T_circle_needle: SE3) -> float:
    """Return the largest rotation of the giver's joints, from where it starts to where it holds the needle."""
    q = parting(giver.setup, T_circle_needle, giver.start_q).q[0]
    return float(np.nanmax(np.abs(q - giver.start_q)[np.arange(6) != INSERTION], initial=0.0))


def _room_at(setup: SutureSetup, T_circle_needle: SE3) -> NDArray[np.float64]:
    """Return the room (n,) of an arm that holds a needle at these poses (n,), and comes or goes with open jaws."""
    there = (T_circle_needle @ grasp_pose(setup)).matrix
    back = there.copy()
    back[:, :3, 3] += COMES_FROM_M * there[:, :3, 2]
    q = ik_unbounded(setup.arm, setup.T_base_circle @ SE3.unchecked(np.stack([there, back], axis=1)))
    return room_rad(setup.arm, q).min(axis=1)


def _unit(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
