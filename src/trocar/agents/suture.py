"""One arm drives sutures along the needle primitive (paper, III-C2 and section IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trio
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.agents.logged_arm import LoggedArm
from trocar.arms import MOTION_LIMITS, MotionLimits
from trocar.cell import Cell, Outcome
from trocar.errors import TrocarError
from trocar.sutures.drive import Stretch, Suture, drive, ranges
from trocar.trajectory import Trajectory

KNOT_S = 0.020
"""Spacing of a motion's knots: two control periods."""

TRAVELS = ("lower", "withdraw", "rise")
"""Stretches on which nothing is near the needle's way: done at the speed of travel."""

JOINED = 1e-3
"""A stretch that starts no further (rad, m) from where the arm is goes on from there."""


def _gentle() -> MotionLimits:
    limits = MOTION_LIMITS["paper"]
    return MotionLimits(0.2 * limits.velocity, 0.2 * limits.acceleration)


@dataclass(frozen=True)
class SutureSettings:
    """How the agent works; lengths in m, angles in rad, times on the cell's clock in s.

    Attributes:
        arm: which arm does it.
        planning_budget_s: declared for the joint paths of a suture.
        settle_s: rest after a motion before the jaws act.
        driving_speed: mean speed of the jaws along the primitive, m/s.
        travel_speed: mean speed on the way in and out, m/s.
        jaw_open: opening that clears the wire.
        jaw_closed: target that lets the drive press.
        jaw_empty: jaws that close further than this hold nothing; a wire of .9 mm keeps them open by .09.
        limits: of velocity and acceleration on the way from suture to suture.
    """

    arm: str = "psm1"
    planning_budget_s: float = 0.05
    settle_s: float = 0.1
    driving_speed: float = 0.008
    travel_speed: float = 0.020
    jaw_open: float = 0.40
    jaw_closed: float = -0.17
    jaw_empty: float = 0.04
    limits: MotionLimits = field(default_factory=_gentle)


class CircleSuturing:
    """One arm drives one suture after the other; a person loads the needle before each."""

    def __init__(self, cell: Cell, settings: SutureSettings):
        self.hand = LoggedArm(cell, settings.arm, settings.limits, settings.settle_s)
        if cell.assistant is None:
            raise TrocarError("nobody in this cell loads the needle; give the cell an assistant")
        self.cell, self.settings, self.assistant = cell, settings, cell.assistant
        self.arm = self.hand.model
        self.home = self.hand.q

    async def run(self, sutures: Sequence[Suture]) -> None:
        """Drive the sutures one after the other; where a joint's limit is hit, stop there and do no more."""
        await self.hand.wake()
        for number, suture in enumerate(sutures):
            start_s = trio.current_time()
            outcome, reason = await self._suture(number, suture)
            if outcome is not Outcome.JOINT_LIMIT:
                await self.hand.go(self.home)
            self.cell.log.event(
                "suture",
                suture=number,
                theta_rad=suture.theta_rad,
                direction=suture.direction,
                start_s=round(start_s, 6),
                outcome=outcome.name,
                reason=reason,
            )
            if outcome is Outcome.JOINT_LIMIT:
                return

    async def _suture(self, number: int, suture: Suture) -> tuple[Outcome, str]:
        """Load, drive, let go; return how it ended, and a sentence where it went wrong."""
        stretches = await self.hand.compute(
            "planning", self.settings.planning_budget_s, lambda: drive(self._here(suture))
        )
        await self.hand.jaw(self.settings.jaw_open)
        with self.cell.log.span(self.settings.arm, "loading"):
            await self.assistant.load(self.settings.arm)
        if not await self._grip():
            return Outcome.NEEDLE_MISSED, f"suture {number + 1}: the jaws did not hold the needle that they were given"
        for stretch in stretches:
            self.cell.log.event("step", suture=number, step=stretch.name)
            if stretch.regrasps or stretch.name == "withdraw":
                await self.hand.jaw(self.settings.jaw_open)
            reason = await self._follow(number, stretch)
            if reason:
                return Outcome.JOINT_LIMIT, reason
            if stretch.regrasps and not await self._grip():
                await self.hand.jaw(self.settings.jaw_open)
                await self._leave(number, stretches[-2:])
                return Outcome.NEEDLE_MISSED, f"suture {number + 1}: the jaws closed on nothing after {stretch.name}"
        return Outcome.DONE, ""

    def _here(self, suture: Suture) -> Suture:
        """Return the suture as this laboratory's registration places arm and circle."""
        setup = suture.setup
        circle = replace(setup.circle, T_world_circle=self.cell.T_world_board)
        base = self.cell.T_world_base[self.settings.arm]
        return replace(suture, setup=replace(setup, arm=self.arm, T_world_base=base, circle=circle))

    async def _follow(self, number: int, stretch: Stretch) -> str:
        """Move along a stretch, as far as the joints' ranges allow; return a sentence where they do not."""
        outside = stretch.first_outside(self.arm)
        q = stretch.q if outside is None else stretch.q[: outside[0]]
        reason = "" if outside is None else self._limit(number, stretch, *outside)
        travels = stretch.name in TRAVELS
        speed = self.settings.travel_speed if travels else self.settings.driving_speed
        seconds = stretch.length_m / speed * len(q) / max(1, len(stretch.q))
        try:
            if len(q) and np.abs(q[0] - self.hand.q).max() > JOINED:
                await self.hand.go(q[0])
            if len(q) > 1:
                await self.hand.move(along(np.concatenate([self.hand.q[None], q[1:]]), seconds))
        except TrocarError as error:
            return f"suture {number + 1}, {stretch.name}: {error}; stopped before it"
        return reason

    def _limit(self, number: int, stretch: Stretch, place: int, joint: int) -> str:
        """Return what a path asks of a joint that the joint cannot do."""
        where = f"suture {number + 1}, {stretch.name}"
        if joint < 0:
            return f"{where}: no configuration of {self.arm.name} reaches the pose {place} of {len(stretch.q)}"
        limits, values = self.arm.joints[joint], stretch.q[place:, joint]
        lower, upper = (float(bound[joint]) for bound in ranges(self.arm))
        lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
        wanted = lowest if lower - lowest > highest - upper else highest
        scale, unit = (1e3, "mm") if limits.prismatic else (180 / math.pi, "deg")
        return (
            f"{where}: joint '{limits.name}' would go to {scale * wanted:.1f} {unit}, outside "
            f"[{scale * lower:.1f}, {scale * upper:.1f}] {unit}; stopped there"
        )

    async def _leave(self, number: int, way_out: Sequence[Stretch]) -> None:
        """Go from where a suture was given up as one goes from its end: back along the jaws, then up."""
        for stretch in way_out:
            self.cell.log.event("step", suture=number, step=stretch.name)
            if len(stretch.q) > 1:
                path = np.clip(self.hand.q + stretch.q - stretch.q[0], self.arm.lower, self.arm.upper)
                await self.hand.move(along(path, stretch.length_m / self.settings.travel_speed))

    async def _grip(self) -> bool:
        """Close the jaws; return whether they stalled on a wire."""
        await self.hand.settle()
        await self.hand.jaw(self.settings.jaw_closed)
        await self.hand.settle()
        return self.hand.jaw_rad > self.settings.jaw_empty


def along(q: NDArray[np.float64], seconds: float) -> Trajectory:
    """Return the motion through a dense joint path (k, 6), k > 1, from rest to rest with the least jerk."""
    count = max(2, math.ceil(seconds / KNOT_S))
    times = np.linspace(0.0, max(seconds, count * 1e-3), count + 1)
    tau = times / times[-1]
    share = tau**3 * (10 - 15 * tau + 6 * tau**2)
    rate = 30 * tau**2 * (1 - tau) ** 2 / times[-1]
    path = CubicSpline(np.linspace(0.0, 1.0, len(q)), q)
    return Trajectory.hermite(times, path(share), rate[:, None] * path(share, 1))
