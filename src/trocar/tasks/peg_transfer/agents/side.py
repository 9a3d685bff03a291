"""What two arms tell each other about one transfer, and actions common to both sides of a handover."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

import numpy as np
import trio

from trocar.geometry import SE3
from trocar.robots.concurrency import first_of
from trocar.tasks.peg_transfer.agents.meeting import Partner, Ways
from trocar.tasks.peg_transfer.agents.peg_arm import PegArm
from trocar.tasks.peg_transfer.agents.unilateral import OneArm
from trocar.tasks.peg_transfer.goals import Transfer, TransferOutcome

AGAIN = (TransferOutcome.BLOCKED, TransferOutcome.NOT_GRASPED, TransferOutcome.DROPPED)
"""Outcomes of a meeting after which another try is worthwhile: the block is back where it was, or has slipped back."""


@dataclass(eq=False)
class HandoverState:
    """What the two scripts tell each other about one transfer.

    Attributes:
        goal: the transfer.
        start_s: when the giving arm began.
        turns: when each arm began and ended its part, over all meetings for this transfer; inf: not yet.
        T_board_block: where the block is offered, according to the giving arm's joints.
        T_board_giver: pose of the giving tip there.
        passed: whether the receiving arm has had the block.
        announced: it is known where the block will be offered.
        crowded: the receiving arm, waiting above, is in the giving one's way.
        offered: the giving arm holds the block still, and waits.
        taken: the receiving arm holds it too.
        released: the giving arm has opened its jaws.
        parted: and has risen out of the block.
        outcome: why it failed; None: it has not failed.
        reason: a sentence, if there is one.
    """

    goal: Transfer
    start_s: float = 0.0
    turns: dict[str, tuple[float, float]] = field(default_factory=dict)
    T_board_block: SE3 | None = None
    T_board_giver: SE3 | None = None
    outcome: TransferOutcome | None = None
    reason: str = ""
    passed: bool = False
    announced: trio.Event = field(default_factory=trio.Event)
    crowded: trio.Event = field(default_factory=trio.Event)
    offered: trio.Event = field(default_factory=trio.Event)
    taken: trio.Event = field(default_factory=trio.Event)
    released: trio.Event = field(default_factory=trio.Event)
    parted: trio.Event = field(default_factory=trio.Event)

    def announce(self, T_board_giver: SE3, T_tip_block: SE3) -> None:
        """Announce where the block will be offered."""
        self.T_board_giver, self.T_board_block = T_board_giver, T_board_giver @ T_tip_block
        self.announced.set()

    def fail(self, outcome: TransferOutcome, reason: str = "") -> None:
        """End it."""
        if self.outcome is None:
            self.outcome, self.reason = outcome, reason
        for event in (self.announced, self.crowded, self.offered, self.taken, self.released, self.parted):
            event.set()


class Side:
    """One of the two arms of a handover.

    Attributes:
        arm: this one.
        other: its partner.
        script: how this one picks blocks, and what it has seen of the next one.
    """

    def __init__(self, arm: PegArm, other: PegArm, script: OneArm):
        self.arm, self.other, self.script = arm, other, script
        self.cell, self.settings, self.table = arm.cell, arm.settings, arm.table

    @property
    def own_side(self) -> float:
        """Return the sign of x in the board's frame on the side of the arm's base."""
        return float(np.sign(self.arm.motions.T_base_board.inverse().translation_m[0]))

    async def rise(self) -> None:
        """Rise straight out of a block that the other arm holds."""
        await self.arm.shift((0.0, 0.0, self.settings.parts_m), self.settings.meeting_margin_m, contact_s=(0.0, inf))

    async def wait_for(self, *events: trio.Event) -> None:
        """Wait for the other arm: for the first of several events."""
        with self.cell.log.span(self.arm.name, "waiting"):
            await first_of(*events)

    def partners(self, giver: PegArm, receiver: PegArm) -> tuple[Partner, Partner]:
        """Return both arms; the giving one's jaws are closed on a block."""
        bases, held_rad = self.cell.T_world_base_registered, giver.hand.jaw_rad
        return (
            Partner(giver.model, bases[giver.name], self.settings.release_rad, held_rad),
            Partner(receiver.model, bases[receiver.name], self.settings.taking_rad, held_rad),
        )

    def ways(self) -> Ways:
        """Return how the arms meet and separate."""
        settings, wall_m = self.settings, self.table.block.wall_middle_m
        return Ways(settings.waits_above_m, settings.parts_m, settings.depth_m, wall_m)
