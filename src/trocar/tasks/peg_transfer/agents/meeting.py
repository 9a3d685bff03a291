"""Where one arm hands a block to another, and how both hold it: from above, on two sides, with their jaws apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import capsule_distances_m
from trocar.tasks.peg_transfer.grasps import Grasp, vertical_grasps, wrist_has_room
from trocar.tasks.peg_transfer.shapes import Block

YAWS_RAD = np.radians(np.arange(0.0, 360.0, 7.5))
"""Rotations of the giving tool that are tried."""
ROOM_M = 2.4e-3
"""Distance between the arms that is enough, so that no tool need turn for more."""
MIN_ROOM_M = 1.0e-3
"""Distance below which they block each other: three of five pairs that came closer could not separate."""
MAX_ROLL_RAD = np.radians(110.0)
SHARES = (0.0, 0.5, 1.0)
"""Shares of the receiving arm's way down, and of the giving arm's way up, at which distances are checked."""


@dataclass(frozen=True, eq=False)
class Partner:
    """An arm that takes part.

    Attributes:
        model: of the arm.
        T_world_base: its base as registered.
        open_rad: opening of its jaws round a wall.
        held_rad: opening when closed on it.
    """

    model: ArmModel
    T_world_base: SE3
    open_rad: float
    held_rad: float


@dataclass(frozen=True)
class Ways:
    """How two arms come to hold one block, and how they separate.

    Attributes:
        above_m: height from which the receiving arm comes down.
        parts_m: height by which the giving arm rises then.
        depth_m: of a tip under the block's top face.
        wall_m: from the block's middle to that of a wall, round which the receiving jaws come down, without a peg
            beside them.
    """

    above_m: float
    parts_m: float
    depth_m: float
    wall_m: float


@dataclass(frozen=True, eq=False)
class Offer:
    """A pose in which to offer a block.

    Attributes:
        T_board_tip: of the giving arm.
        room_m: predicted distance of the arms when the receiving one takes its best grasp.
    """

    T_board_tip: SE3
    room_m: float


def choose_offer(
    giver: Partner,
    receiver: Partner,
    T_world_board: SE3,
    T_board_tip: SE3,
    T_tip_block: SE3,
    block: Block,
    meeting_m: NDArray[np.float64],
    ways: Ways,
) -> Offer | str:
    """Return how to offer a block so that the other arm can take it, or one sentence why that is impossible.

    The tool turns as little as possible to leave ``ROOM_M`` between the arms; if that is impossible, to where there is
    most room.

    Args:
        giver: holds the block.
        receiver: is to take it.
        T_world_board: pose of the board.
        T_board_tip: of the giving arm now; only its yaw matters.
        T_tip_block: pose of the block in its jaws.
        block: its shape.
        meeting_m: (3,) position of the middle of the block's lower face in the board's frame.
        ways: how they meet and separate.
    """
    best: Offer | None = None
    now = float(np.arctan2(T_board_tip.matrix[1, 0], T_board_tip.matrix[0, 0]))
    turns = sorted(YAWS_RAD, key=lambda turn: abs((turn + np.pi) % (2 * np.pi) - np.pi))
    for turn in turns:
        upright = SO3.axis("z", now + turn)
        middle = meeting_m + np.array([0.0, 0.0, block.height_m])
        pose = SE3.from_parts(upright, middle - upright.apply(T_tip_block.translation_m))
        taken = _best_grasp(giver, receiver, T_world_board, pose @ T_tip_block, pose, ways)
        if taken is not None and (best is None or taken.clearance_m > best.room_m):
            best = Offer(pose, taken.clearance_m)
        if best is not None and best.room_m >= ROOM_M:
            return best
    return best or "there is no pose in which both arms could hold the block"


def choose_taking(
    giver: Partner,
    receiver: Partner,
    T_world_board: SE3,
    T_board_block: SE3,
    T_board_giver: SE3,
    ways: Ways,
    avoid: tuple[int, ...] = (),
    near: SE3 | None = None,
) -> Grasp | str:
    """Return the grasp of a block in the other arm's jaws that keeps the arms furthest apart, or why there is none.

    Its ``clearance_m`` is the least distance of the arms on the way down.

    Args:
        giver: holds the block.
        receiver: is to take it.
        T_world_board: pose of the board.
        T_board_block: pose of the block, as it was seen.
        T_board_giver: of the giving tip, according to its joints.
        ways: how they meet and separate.
        avoid: grasps that have failed.
        near: the pose of the tip, except for its height, near which the grasp has to be; None: anywhere.
    """
    best = _best_grasp(giver, receiver, T_world_board, T_board_block, T_board_giver, ways, avoid, near)
    if best is None:
        return "no grasp of the block in the other arm's jaws is in reach"
    if best.clearance_m < MIN_ROOM_M:
        return f"no grasp of the block leaves the arms more than {1e3 * best.clearance_m:.1f} mm between them"
    return best


def joints_at(partner: Partner, T_world_board: SE3, T_board_tip: SE3) -> NDArray[np.float64] | None:
    """Return the joints (6,) that hold a tip at a pose with the wrist well within its ranges, or None."""
    try:
        q = ik(partner.model, partner.T_world_base.inverse() @ T_world_board @ T_board_tip)
    except OutOfReach:
        return None
    return q if wrist_has_room(partner.model, q, MAX_ROLL_RAD) else None


def _best_grasp(
    giver: Partner,
    receiver: Partner,
    T_world_board: SE3,
    T_board_block: SE3,
    T_board_giver: SE3,
    ways: Ways,
    avoid: tuple[int, ...] = (),
    near: SE3 | None = None,
) -> Grasp | None:
    """Return the grasp that leaves most room while the receiving arm comes down and the giving one rises."""
    leaving = _joints_above(giver, T_world_board, T_board_giver, ways.parts_m)
    if leaving is None:
        return None
    holding = capsules(giver.model, leaving[0], giver.held_rad).moved(giver.T_world_base)
    rising = capsules(giver.model, leaving, giver.open_rad).moved(giver.T_world_base)
    best: Grasp | None = None
    for candidate, T_board_tip in enumerate(vertical_grasps(T_board_block, ways.depth_m, ways.wall_m)):
        if candidate in avoid or _same_side(T_board_tip, T_board_giver):
            continue
        for pose in (T_board_tip, T_board_tip @ SE3.from_parts(SO3.axis("z", np.pi))):
            if near is not None and not _near(pose, near):
                continue
            coming = _joints_above(receiver, T_world_board, pose, ways.above_m)
            if coming is None:
                continue
            lowering = capsules(receiver.model, coming, receiver.open_rad).moved(receiver.T_world_base)
            taking = capsules(receiver.model, coming[0], receiver.held_rad).moved(receiver.T_world_base)
            room = min(
                float(capsule_distances_m(lowering, holding).min()), float(capsule_distances_m(rising, taking).min())
            )
            if best is None or room > best.clearance_m:
                best = Grasp(pose, coming[0], receiver.open_rad, room, candidate)
    return best


def _joints_above(partner: Partner, T_world_board: SE3, T_board_tip: SE3, by_m: float) -> NDArray[np.float64] | None:
    """Return the joints (n, 6) at a pose and at some heights over it, or None."""
    way = [joints_at(partner, T_world_board, _above(T_board_tip, share * by_m)) for share in SHARES]
    return None if any(q is None for q in way) else np.array(way)


def _same_side(T_board_tip: SE3, T_board_giver: SE3) -> bool:
    """Return whether a grasp is beside that of the giving jaws, on the same wall: within 4 mm."""
    return bool(np.linalg.norm(T_board_tip.translation_m[:2] - T_board_giver.translation_m[:2]) < 4e-3)


def _near(T_board_tip: SE3, T_board_other: SE3) -> bool:
    """Return whether two tips are within 4 mm and 20 deg, seen from above."""
    apart = T_board_tip.inverse() @ T_board_other
    off_m = np.linalg.norm((T_board_tip.translation_m - T_board_other.translation_m)[:2])
    return bool(off_m < 4e-3 and np.linalg.norm(apart.rotation.log()) < np.radians(20.0))


def _above(T_board_tip: SE3, by_m: float) -> SE3:
    return SE3.from_parts(T_board_tip.rotation, T_board_tip.translation_m + [0.0, 0.0, by_m])
