"""Handover of a block from one arm to another: where and how both hold it, and the state that their scripts share."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.robots.concurrency import first_of
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.unilateral import OneArm
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome
from trocar.tasks.peg_transfer.grasps import YAWS_RAD, Grasp, vertical_grasps, wrist_has_room, yaw_of
from trocar.tasks.peg_transfer.shapes import Block

ROOM_M = 2.4e-3
"""Sufficient distance between the arms, if the receiving one is out of the way: the tool does not turn to gain more."""
MIN_ROOM_M = 1.0e-3
"""Distance below which they block each other: three of five pairs that came closer could not separate."""
TAKING_ASIDE_M = (-1.2e-3, 1.2e-3)
"""Distances along a wall, from its middle, at which the receiving arm grasps: nearer to the wall's end there is more
room. At 1.4 mm, 3 of 99 tries came down on the corner of the hole."""
MAX_ROLL_RAD = np.radians(110.0)
SHARES = (0.0, 0.5, 1.0)
"""Shares of the receiving arm's way down, and of the giving arm's way up, at which distances are checked."""
NEAR_M, NEAR_RAD = 4e-3, np.radians(20.0)
"""Tips this close, seen from above, are at the same wall; if their rotations differ by less, it is the same grasp."""
IN_THE_WAY_M = 0.4e-3
"""A receiving arm that stands where the giving one comes from, or goes to, counts as this much closer."""
AHEAD_RAD = np.radians(100.0)
"""It stands there if it is within this angle of that direction, seen from above. So it did in 110 handovers: in 33 of
them the giving arm had to go another way, and in 2 of 133 others."""
HELD_RAD = 0.20
"""Expected opening of jaws on a wall, for plans that are made before they close."""
ASIDE_M = 28e-3
"""How far towards its own side an arm waits for a block, or goes after it has given one."""


@dataclass(frozen=True, eq=False)
class Partner:
    """An arm that takes part."""

    model: ArmModel
    T_world_base: SE3  # its base, as far as is known
    T_world_base_registered: SE3  # from where the robot's guard measures distances
    open_rad: float  # opening of its jaws round a wall
    held_rad: float  # opening when closed on it


@dataclass(frozen=True, eq=False)
class Offer:
    """A pose in which to offer a block."""

    T_board_tip: SE3  # of the giving arm
    room_m: float  # predicted distance of the arms when the receiving one takes its best grasp


@dataclass(frozen=True, eq=False)
class HandoverGeometry:
    """Two arms that are to hold one block: from above, on two sides, with their jaws apart."""

    giver: Partner  # holds the block
    receiver: Partner  # is to take it
    T_world_board: SE3
    block: Block
    # Meeting point, height from which the receiving arm comes down, height by which the giving arm then rises.
    settings: Settings
    from_and_to_m: NDArray[np.float64]  # (n, 2) where on the board the giving arm comes from, and where it goes then

    def choose_offer(self, T_board_tip: SE3, T_tip_block: SE3) -> Offer | str:
        """Return how to offer a block so that the other arm can take it, or one sentence why that is impossible.

        The tool turns as little as possible from its present pose ``T_board_tip`` to leave ``ROOM_M`` between the arms,
        and the receiving arm out of the giving one's way. If no rotation does, the best one is chosen: the one with the
        most room, less ``IN_THE_WAY_M`` for arms in the way.
        """
        best, most_m = None, -inf
        now = yaw_of(T_board_tip)
        middle = np.array(self.settings.meeting_m) + np.array([0.0, 0.0, self.block.height_m])
        for turn in sorted(YAWS_RAD, key=lambda turn: abs((turn + np.pi) % (2 * np.pi) - np.pi)):
            upright = SO3.axis("z", now + turn)
            pose = SE3.from_parts(upright, middle - upright.apply(T_tip_block.translation_m))
            taken = self._best_grasp(pose @ T_tip_block, pose)
            if taken is None:
                continue
            preference_m = self._preference_m(taken.clearance_m, taken.T_board_tip, pose)
            if preference_m > most_m:
                best, most_m = Offer(pose, taken.clearance_m), preference_m
            if most_m >= ROOM_M:
                break
        return best or "there is no pose in which both arms could hold the block"

    def choose_taking(
        self, T_board_block: SE3, T_board_giver: SE3, avoid: Collection[int] = (), near: SE3 | None = None
    ) -> Grasp | str:
        """Return the best grasp of a block in the other arm's jaws, by room and way, or why there is none.

        Its ``clearance_m`` is the least distance of the arms while the receiving one descends and the giving one rises.

        Args:
            T_board_block: pose of the block, as it was seen.
            T_board_giver: pose of the giving arm's tip, according to its joints.
            avoid: grasps that have failed.
            near: pose of the tip that the grasp has to be close to, except for the height; None: any grasp.
        """
        best = self._best_grasp(T_board_block, T_board_giver, avoid, near)
        if best is None:
            return "no grasp of the block in the other arm's jaws is in reach"
        if best.clearance_m < MIN_ROOM_M:
            return f"no grasp of the block leaves the arms more than {1e3 * best.clearance_m:.1f} mm between them"
        return best

    def _best_grasp(
        self, T_board_block: SE3, T_board_giver: SE3, avoid: Collection[int] = (), near: SE3 | None = None
    ) -> Grasp | None:
        """Return the best grasp, by the room while one arm comes down and the other rises, and by who is in the way."""
        giver, receiver, settings = self.giver, self.receiver, self.settings
        leaving = self._joints_above(giver, T_board_giver, settings.parts_m)
        if leaving is None:
            return None
        holding = capsules(giver.model, leaving[0], giver.held_rad)
        rising = capsules(giver.model, leaving, giver.open_rad)
        T_giver_receiver = giver.T_world_base.inverse() @ receiver.T_world_base
        T_guarded = giver.T_world_base_registered.inverse() @ receiver.T_world_base_registered
        best, most_m = None, -inf
        grasps = vertical_grasps(T_board_block, settings.depth_m, self.block.wall_middle_m, TAKING_ASIDE_M)
        for candidate, T_board_tip in enumerate(grasps):
            if candidate in avoid or _apart_m(T_board_tip, T_board_giver) < NEAR_M:
                continue
            for pose in (T_board_tip, T_board_tip @ SE3.from_parts(SO3.axis("z", np.pi))):
                if near is not None and not _same_grasp(pose, near):
                    continue
                coming = self._joints_above(receiver, pose, settings.waits_above_m)
                if coming is None:
                    continue
                lowering = capsules(receiver.model, coming, receiver.open_rad)
                taking = capsules(receiver.model, coming[0], receiver.held_rad)
                both = (lowering, holding), (taking, rising)
                room_m = _room_m(both, T_giver_receiver)
                if self._preference_m(room_m, pose, T_board_giver) > most_m:
                    room_m = min(room_m, _room_m(both, T_guarded))  # the guard measures from the registered bases
                if (preference_m := self._preference_m(room_m, pose, T_board_giver)) > most_m:
                    best, most_m = Grasp(pose, coming[0], receiver.open_rad, room_m, candidate), preference_m
        return best

    def _preference_m(self, room_m: float, T_board_receiver: SE3, T_board_giver: SE3) -> float:
        """Return the distance between the arms, or less if the receiving one stands in the giving one's way.

        A grasp that leaves enough room is never worth less than one that does not.
        """
        giver_m = T_board_giver.translation_m[:2]
        off_m, ways_m = T_board_receiver.translation_m[:2] - giver_m, self.from_and_to_m - giver_m
        ahead = ways_m @ off_m > np.cos(AHEAD_RAD) * np.linalg.norm(off_m) * np.linalg.norm(ways_m, axis=1)
        return max(room_m - IN_THE_WAY_M, min(room_m, MIN_ROOM_M)) if ahead.any() else room_m

    def _joints_above(self, partner: Partner, T_board_tip: SE3, by_m: float) -> NDArray[np.float64] | None:
        """Return the joints (n, 6) at a pose and at some heights over it; None if they are out of reach."""
        way = []
        for share in SHARES:
            up = SE3.from_parts(T_board_tip.rotation, T_board_tip.translation_m + [0.0, 0.0, share * by_m])
            try:
                way.append(ik(partner.model, partner.T_world_base.inverse() @ self.T_world_board @ up))
            except OutOfReach:
                return None
            if not wrist_has_room(partner.model, way[-1], MAX_ROLL_RAD):
                return None
        return np.array(way)


def _room_m(pairs: Sequence[tuple[Capsules, Capsules]], T_giver_receiver: SE3) -> float:
    """Return the least distance within pairs of solids of the receiving and the giving arm, each in its base frame."""
    return min(float(capsule_distances_m(one.moved(T_giver_receiver), other).min()) for one, other in pairs)


def _apart_m(T_board_a: SE3, T_board_b: SE3) -> float:
    """Return the distance of two tips, seen from above."""
    return float(np.linalg.norm(T_board_a.translation_m[:2] - T_board_b.translation_m[:2]))


def _same_grasp(T_board_tip: SE3, T_board_other: SE3) -> bool:
    turned_rad = np.linalg.norm((T_board_tip.inverse() @ T_board_other).rotation.log())
    return bool(_apart_m(T_board_tip, T_board_other) < NEAR_M and turned_rad < NEAR_RAD)


@dataclass(eq=False)
class HandoverState:
    """One attempt to hand over a block, as both arms' scripts see it."""

    goal: Transfer
    giver: str  # name of the giving arm
    next_source: int | None = None  # peg to which the giving arm will go next, as far as is known
    may_repeat: bool = False  # whether another attempt may follow this one
    start_s: float = 0.0  # when the giving arm began
    # when each arm began and ended its part, over all meetings for this transfer; inf: not yet
    turns: dict[str, tuple[float, float]] = field(default_factory=dict)
    T_board_block: SE3 | None = None  # where the block is offered, according to the giving arm's joints
    T_board_giver: SE3 | None = None  # pose of the giving tip there
    T_board_seen: SE3 | None = None  # where the receiving arm saw it, if that leaves no room to take it
    outcome: TransferOutcome | None = None  # why it failed; None: it has not failed
    reason: str = ""  # a sentence, if there is one
    passed: bool = False  # whether the receiving arm has had the block
    announced: trio.Event = field(default_factory=trio.Event)  # it is known where the block will be offered
    begun: trio.Event = field(default_factory=trio.Event)  # the giving arm brings it
    # the receiving arm is in the giving one's way; renewed when it leaves that way
    crowded: trio.Event = field(default_factory=trio.Event)
    offered: trio.Event = field(default_factory=trio.Event)  # the giving arm holds the block still, and waits
    taken: trio.Event = field(default_factory=trio.Event)  # the receiving arm holds it too
    released: trio.Event = field(default_factory=trio.Event)  # the giving arm has opened its jaws
    parted: trio.Event = field(default_factory=trio.Event)  # and has risen out of the block

    def announce(self, T_board_giver: SE3, T_tip_block: SE3) -> None:
        """Announce where the block will be offered."""
        self.T_board_giver, self.T_board_block = T_board_giver, T_board_giver @ T_tip_block
        self.announced.set()

    def fail(self, outcome: TransferOutcome, reason: str = "") -> None:
        """End this attempt, and wake whoever waits for it; the first outcome counts."""
        if self.outcome is None:
            self.outcome, self.reason = outcome, reason
        for event in (self.announced, self.begun, self.crowded, self.offered, self.taken, self.released, self.parted):
            event.set()


class Side:
    """One of the two arms of a handover: this ``arm``, its ``other`` partner, and the ``script`` that picks blocks."""

    def __init__(self, arm: PegArm, other: PegArm, script: OneArm):
        self.arm, self.other, self.script = arm, other, script
        self.cell, self.settings, self.table = arm.cell, arm.settings, arm.table

    @property
    def own_side(self) -> float:
        """Return the sign of x in the board's frame on the side of the arm's base."""
        return float(np.sign(self.arm.motions.T_base_board.inverse().translation_m[0]))

    async def rise(self, waits: bool = True) -> None:
        """Rise straight out of a block that the other arm holds; ``waits`` as in ``PegArm.move``."""
        up_m, margin_m = (0.0, 0.0, self.settings.parts_m), self.settings.meeting_margin_m
        await self.arm.shift(up_m, margin_m, contact_s=(0.0, inf), waits=waits)

    async def wait_for(self, *events: trio.Event) -> None:
        """Wait for the other arm, until the first of several events."""
        with self.cell.log.span(self.arm.name, "waiting"):
            await first_of(*events)

    def geometry(self, giver: PegArm, receiver: PegArm, meeting: HandoverState) -> HandoverGeometry:
        """Return the geometry of a handover; jaws that do not hold the block yet will be open by ``HELD_RAD``."""
        pegs = [peg for peg in (meeting.goal.source, meeting.next_source) if peg is not None]
        held_rad = giver.hand.jaw_rad if giver.holds else HELD_RAD
        gives, takes = (
            Partner(arm.model, arm.motions.T_world_base, arm.motions.T_world_base_registered, open_rad, held_rad)
            for arm, open_rad in ((giver, self.settings.jaw_open_rad), (receiver, self.settings.taking_rad))
        )
        table, from_and_to_m = self.table, self.table.board.pegs_m[pegs, :2]
        return HandoverGeometry(gives, takes, table.T_world_board, table.block, self.settings, from_and_to_m)
