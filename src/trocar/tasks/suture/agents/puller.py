"""The second arm: it grasps the needle's tip as it comes out, pulls it through, and holds it out to the first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.cell import Cell
from trocar.errors import MotionRefused, TooNear
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.circle import JOINED, Settings
from trocar.tasks.suture.agents.lost_needle import grip_from, places_on_arc
from trocar.tasks.suture.agents.needle_estimator import NeedleEstimate
from trocar.tasks.suture.agents.needle_tracker import NeedleTracker
from trocar.tasks.suture.agents.paths import along
from trocar.tasks.suture.planning.handover import Handover
from trocar.tasks.suture.planning.pull import Grip, Pull, grip_segments, out_segments, reach_segment
from trocar.tasks.suture.planning.segments import Segment
from trocar.trajectory import Trajectory

TRIES, WAIT_S = 20, 0.25
"""How often an arm tries to move while the other is in its way, and the time between two attempts."""
GRASPS = 3
"""How often the jaws try to grasp the needle."""


class Puller:
    """The arm that pulls, with its own looks at the needle.

    Attributes:
        hand: the arm.
        home: (6,) where it rests while the other arm drives.
        tracker: tracks the needle for this arm; None: it works without looks.
    """

    def __init__(self, cell: Cell, hand: ArmScript, settings: Settings):
        self.cell, self.hand, self.settings = cell, hand, settings
        self.home = hand.q
        self.tracker: NeedleTracker | None = None

    async def begin(self) -> None:
        """Prepare wrist and jaws."""
        await self.hand.exercise_wrist()
        await self.hand.zero_jaw(self.settings.jaw_closed_rad)

    @property
    def holds(self) -> bool:
        """Return whether the jaws are kept open by a wire."""
        return self.hand.jaw_rad > self.settings.jaw_empty_rad

    async def grasp(self, grip: Grip, needle: NeedleEstimate | None) -> bool:
        """Grasp the needle that the other arm, or the tissue, holds; return whether the jaws hold it.

        Args:
            grip: the planned grip.
            needle: the needle's pose in this arm's base; None: as planned.
        """
        reach = reach_segment(grip)
        T_base_needle = (grip.setup.T_base_circle @ grip.T_circle_needle(np.array([grip.turn_rad[0]])))[0]
        if self.tracker and needle:
            self.tracker.rests(needle)
        await self.hand.jaw(self.settings.jaw_open_rad)
        for _ in range(GRASPS):
            way = self.tracker.towards_needle(reach, T_base_needle) if self.tracker else reach
            if not await self.follow(way, self.settings.travel_speed_m_s):
                return False
            if await self.close():
                if self.tracker:
                    self.tracker.took(grip.setup)
                return True
            await self.hand.jaw(self.settings.jaw_open_rad)
            await self.follow(replace(way, q=way.q[::-1]), self.settings.travel_speed_m_s)
            if self.tracker:
                await self.tracker.find()
        return False

    async def pull(self, pull: Pull) -> bool:
        """Pull the needle through along its arc in two grips, draw it out and lift it.

        The jaws already hold the needle in the first grip. If they lose it in the tissue, they take it again.

        Returns:
            Whether the jaws still hold it.
        """
        first, last = pull.grips
        if not await self._carry(first):
            return False
        needle = self.tracker.needle if self.tracker else None
        if not await self._open_and_leave(first):
            return False
        if self.tracker and needle:
            self.tracker.rests(needle)
            await self.tracker.find()
            needle = self.tracker.needle
        return await self.grasp(last, needle) and await self._carry(last, out=True)

    async def _carry(self, grip: Grip, out: bool = False) -> bool:
        """Move the needle along a grip's path, then ``out``; take it again if the jaws lose it in the tissue.

        Returns:
            Whether the jaws hold it at the end.
        """
        left: Grip | None = grip
        for _ in range(GRASPS):
            if await self._move_needle(grip_segments(left)[1], *(out_segments(left) if out else ())):
                return True
            if self.holds or (left := await self._take_again(left)) is None:
                return False
        return False

    async def _take_again(self, grip: Grip) -> Grip | None:
        """Find and grasp the needle that the jaws lost; return the rest of the grip, or None if that failed."""
        if not self.tracker:
            return None
        self.cell.log.event("needle lost", arm=self.hand.name)
        if not await self._open_and_leave(grip):
            return None
        for place in places_on_arc(grip):
            self.tracker.rests(place)
            await self.tracker.look()
            if self.tracker.seen:
                needle = self.tracker.needle
                left = grip_from(grip, needle.T_base_needle)
                return left if left and await self.grasp(left, needle) else None
        return None

    async def _open_and_leave(self, grip: Grip) -> bool:
        """Open the jaws and go away from the needle; return whether that was possible."""
        await self.hand.jaw(self.settings.jaw_open_rad)
        leave = grip_segments(grip)[2]
        back = replace(leave, q=leave.q + (self.hand.q - leave.q[0]))
        return await self.follow(back, self.settings.travel_speed_m_s)

    async def _move_needle(self, *segments: Segment) -> bool:
        """Move the needle along segments; return whether the jaws still hold it."""
        for segment in segments:
            self.cell.log.event("step of second arm", step=segment.name)
            way = self.tracker.with_needle(segment) if self.tracker else segment
            speed_m_s = self.settings.travel_speed_m_s if segment.name == "lift" else self.settings.pulling_speed_m_s
            if not await self.follow(way, speed_m_s):
                return False
        return self.holds

    async def present(self, handover: Handover) -> bool:
        """Bring the needle to where the other arm takes it, and look at it.

        Returns:
            Whether the jaws hold it there, and can leave it there.
        """
        there = handover.part.first(1)
        way = self.tracker.with_needle(replace(there, q=np.repeat(there.q, 2, axis=0))) if self.tracker else there
        try:
            await self.hand.go(way.q[-1])
            self.cell.robot.prepare({self.hand.name: self._leaving(handover)})
        except MotionRefused as error:
            return self._refused(error)
        if self.tracker:
            await self.tracker.find()
        return self.holds

    async def let_go(self, handover: Handover) -> None:
        """Open the jaws, and leave the needle to the other arm."""
        await self.hand.jaw(self.settings.jaw_open_rad)
        await self.hand.move(self._leaving(handover))

    def _leaving(self, handover: Handover) -> Trajectory:
        """Return the motion of open jaws away from the needle."""
        part = handover.part
        return along(part.q + (self.hand.q - part.q[0]), part.length_m / self.settings.travel_speed_m_s)

    async def come_near(self, pull: Pull) -> None:
        """Go to where the way to the first grip begins."""
        await self._go(reach_segment(pull.grips[0]).q[0])

    async def go_home(self) -> None:
        """Go to where this arm rests, in nobody's way."""
        await self._go(self.home)

    async def _go(self, q: NDArray[np.float64]) -> None:
        """Go to joints (6,), or stay if that is refused: later motions start from wherever the arm is."""
        try:
            await self.hand.go(q)
        except MotionRefused as error:
            self._refused(error)

    def _refused(self, reason: object) -> bool:
        """Note why this arm could not do something; return False."""
        self.cell.log.event("refused", arm=self.hand.name, reason=str(reason))
        return False

    async def close(self) -> bool:
        """Close the jaws; return whether they stalled on a wire."""
        await self.hand.settle()
        await self.hand.jaw(self.settings.jaw_closed_rad)
        await self.hand.settle()
        return self.holds

    async def follow(self, segment: Segment, speed_m_s: float) -> bool:
        """Move along a segment, after going to its start; return whether it was possible.

        While the other arm is in the way, wait until it has left.
        """
        if (outside := segment.first_outside(self.hand.model)) is not None:
            return self._refused(f"{segment.name} leaves a range at {outside}")
        for _ in range(TRIES):
            try:
                if np.abs(segment.q[0] - self.hand.q).max() > JOINED:
                    await self.hand.go(segment.q[0])
                from_here = np.concatenate([self.hand.q[None], segment.q[1:]])
                await self.hand.move(along(from_here, segment.length_m / speed_m_s))
                return True
            except TooNear:
                await self.cell.clock.sleep(WAIT_S)
            except MotionRefused as error:
                return self._refused(error)
        return self._refused(f"{segment.name}: the other arm is in the way")
