"""Two arms sew round the circle: the first drives the needle, the second pulls it through and hands it back.

Their scripts take turns: while one arm moves, the other rests, holding the needle or out of the way.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np
import trio

from trocar.cell import Cell
from trocar.errors import InvalidInput, TooNear
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.circle import JOINED, CircleSuturing, End, missed
from trocar.tasks.suture.agents.lost_needle import look_over
from trocar.tasks.suture.agents.needle_estimator import NeedleEstimate
from trocar.tasks.suture.agents.needle_tracker import NeedleTracker, Stretch
from trocar.tasks.suture.agents.puller import GRASPS, TRIES, WAIT_S, Puller
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import Suture
from trocar.tasks.suture.planning.primitive import driven_steps
from trocar.tasks.suture.planning.segments import Segment
from trocar.tasks.suture.planning.two_arms import SecondArm, TwoArmPlan, plan_two_arms, rising
from trocar.tasks.suture.stand import T_stand_needle

PARTS = (1.0, 0.6, 0.3)
"""Shares of a way up that are tried, one after the other."""
IN_STAND = np.diag(np.repeat([0.5e-3, 0.06], 3) ** 2)
"""How accurately a person sets up the needle: covariance of a twist in the needle's frame, m and rad."""


class TwoArmSuturing(CircleSuturing):
    """One arm drives the sutures, a second one pulls the needle through and hands it back; no person touches it."""

    pulls = True
    plan: TwoArmPlan

    def __init__(self, context: AgentContext):
        super().__init__(context)
        cell, settings = self.cell, self.settings
        hand = ArmScript(cell, context.arms[1], settings.settle_s, settings.limits_share)
        self.puller = Puller(cell, hand, settings)
        if "stand" not in cell.T_world_fixture:
            raise InvalidInput("this cell", "has no fixture 'stand', from which the first needle is taken", "add it")
        self._lost = ""
        self._helpers: trio.Nursery | None = None
        self._near = trio.Event()

    def require_help(self, cell: Cell) -> None:
        """Nobody has to help."""

    async def begin(self) -> None:
        """Prepare both arms, and plan what they do between the sutures."""
        await super().begin()
        await self.puller.begin()
        cell, second = self.cell, self.puller.hand
        base = cell.T_world_base_registered[second.name]
        arm = SecondArm(second.model, base, self.puller.home)
        cameras = list(cell.T_world_camera_registered.values())
        stand, budget_s = cell.T_world_fixture["stand"], self.settings.two_arms_budget_s
        self.plan = await self.hand.compute(
            "planning", budget_s, lambda: plan_two_arms(self.sutures, self.home, arm, stand, cameras)
        )
        if self.tracker:
            setup, pulling = self.sutures[0].setup, self.plan.pulls[0].grips[0].setup
            self.tracker = NeedleTracker(cell, self.hand, setup, self.settings, others=[second])
            self.puller.tracker = NeedleTracker(cell, second, pulling, self.settings, others=[self.hand])
        self._T_first_second = cell.T_world_base_registered[self.hand.name].inverse() @ base

    async def _suture(self, number: int, suture: Suture) -> End:
        """Drive a suture, while the second arm comes and goes beside it."""
        async with trio.open_nursery() as self._helpers:
            end = await super()._suture(number, suture)
        if end.outcome is not SutureOutcome.NEEDLE_DROPPED:
            return end
        await self.puller.go_home()
        await self.go_home()
        where = await self._where_it_lies()
        self._lost = f"neither arm has the needle, {where}"
        return end._replace(reason=f"{end.reason}, {where}")

    async def _where_it_lies(self) -> str:
        """Look for a needle that neither arm has; return in words where it lies."""
        if not self.tracker:
            return "and nothing looks for it"
        found = await look_over(self.tracker, self.hand)
        if found is None:
            return "and it is not seen on the phantom"
        x_mm, y_mm = (1e3 * found.center_m).round(2).tolist()
        self.log.event("needle lies", x_mm=x_mm, y_mm=y_mm, pixels=found.pixels)
        return f"which lies at x {x_mm:.1f} mm, y {y_mm:.1f} mm from the circle's centre"

    async def _stretch(self, number: int, stretch: Stretch, suture: Suture, *leaving: Segment) -> End | None:
        """Follow a stretch; when the last push begins, the second arm comes."""
        if stretch.first and stretch.segment.name == driven_steps(suture.setup)[-1].name:
            self._near = trio.Event()
            self._beside(self._second_comes, number)
        return await super()._stretch(number, stretch, suture, *leaving)

    async def _second_comes(self, number: int) -> None:
        await self.puller.come_near(self.plan.pulls[number])
        self._near.set()

    async def go_home(self) -> None:
        """Go home, as soon as the second arm leaves room."""
        for _ in range(TRIES):
            try:
                await self.hand.go(self.home)
                return
            except TooNear:
                await self.clock.sleep(WAIT_S)

    def _beside(self, action: Callable[..., Awaitable[Any]], *args: Any) -> None:
        """Start an action that runs beside this suture."""
        if self._helpers is not None:
            self._helpers.start_soon(action, *args)

    async def take_needle(self, number: int) -> End | None:
        """Take the needle from its stand, or from the second arm; return the suture's end if that failed."""
        if self._lost:
            return End(SutureOutcome.NOT_DRIVEN, f"suture {number + 1}: {self._lost}")
        self._lost = f"no arm holds the needle as it is needed, since suture {number + 1}"  # until the second one does
        return await (self._from_second(number) if number else self._from_stand())

    async def check_needle(self, number: int, stretch: Stretch, tracker: NeedleTracker) -> End | None:
        """Return the suture's end if the needle is not seen in the jaws: nobody loads it again."""
        if tracker.seen or await tracker.find():
            return None
        return End(SutureOutcome.NEEDLE_DROPPED, f"suture {number + 1}: the needle is not seen in the first arm's jaws")

    async def leave(self, number: int, *planned: Segment) -> None:
        """Retreat as planned; if that is refused from the start, rise straight up as far as possible."""
        before = self.hand.q
        await super().leave(number, *planned)
        if np.abs(self.hand.q - before).max() > JOINED:
            return
        rise = rising(self.sutures[number].setup, before)
        for share in PARTS:
            part = rise.first(round(share * len(rise.q)))
            if not await self.follow(number, part):
                self.log.event("rose instead", suture=number, share=share)
                return

    async def finish(self, number: int, withdraw: Segment, rise: Segment) -> End:
        """Have the second arm grasp the tip and pull the needle through, after this arm has let go of it."""
        pull, second = self.plan.pulls[number], self.puller
        self.log.event("step", suture=number, step="grasp tip")
        needle = None
        if self.tracker:
            await self.tracker.find()
            needle = _in_other(self.tracker.needle, self._T_first_second.inverse())
        with self._waiting():
            await self._near.wait()
            grasped = await second.grasp(pull.grips[0], needle)
        if not grasped:
            return missed(number, "the second arm's jaws closed on nothing where the needle's tip should have been")
        await self.open()
        await self.leave(number, withdraw, rise)
        self._beside(self.go_home)
        self.log.event("step", suture=number, step="pull through")
        with self._waiting():
            pulled = await second.pull(pull)
        if not pulled:
            return End(SutureOutcome.NEEDLE_DROPPED, f"suture {number + 1}: the second arm lost the needle")
        self._lost = ""
        return End(SutureOutcome.DONE)

    def _waiting(self) -> AbstractContextManager[None]:
        """Note that this arm waits for the second one."""
        return self.log.span(self.hand.name, "waiting")

    async def _from_stand(self) -> End | None:
        take, lift = self.plan.stand
        self.log.event("step", suture=0, step="take from stand")
        T_world_base = self.cell.T_world_base_registered[self.hand.name]
        T_base_stand = T_world_base.inverse() @ self.cell.T_world_fixture["stand"]
        T_base_needle = T_base_stand @ T_stand_needle(self.sutures[0].setup.needle)
        if self.tracker:
            self.tracker.T_base_floor = T_base_stand
            self.tracker.rests(NeedleEstimate(T_base_needle, IN_STAND))
            await self.tracker.find()
        reason = await self._take(take, T_base_needle)
        if self.tracker:
            self.tracker.T_base_floor = self.sutures[0].setup.T_base_circle
        if reason:
            return missed(0, f"in its stand, {reason}")
        if self.tracker:
            lift = self.tracker.with_needle(lift)
        await self.follow(0, lift, self.settings.travel_speed_m_s)
        return None

    async def _from_second(self, number: int) -> End | None:
        """Take the needle from the second arm, at the first of the planned places that the commands of both allow."""
        second, reason = self.puller, ""
        self.log.event("step", suture=number, step="hand over")
        for handover in self.plan.handovers[number - 1]:
            if not second.holds:
                return End(SutureOutcome.NEEDLE_DROPPED, f"suture {number + 1}: the second arm lost the needle")
            with self._waiting():
                presented = await second.present(handover)
            if not presented:
                reason = "the second arm cannot hold it out"
                continue
            T_base_needle = self.sutures[number].setup.T_base_circle @ handover.T_circle_needle
            if self.tracker and second.tracker:
                self.tracker.rests(_in_other(second.tracker.needle, self._T_first_second))
            reason = await self._take(handover.take, T_base_needle)
            if not reason:
                with self._waiting():
                    await second.let_go(handover)
                self._beside(second.go_home)
                return None
            await self.go_home()
        return End(SutureOutcome.HANDOVER_REFUSED, f"suture {number + 1}: at the handover, {reason}")

    async def _take(self, take: Segment, T_base_needle: SE3) -> str:
        """Grasp the needle that rests near this pose in the arm's base; return in words why that failed."""
        await self.hand.jaw(self.settings.jaw_open_rad)
        for _ in range(GRASPS):
            way = self.tracker.towards_needle(take, T_base_needle) if self.tracker else take
            if reason := await self.follow(0, way, self.settings.travel_speed_m_s / 2):
                return reason
            if await self.grip():
                if self.tracker:
                    self.tracker.took(self.sutures[0].setup)
                return ""
            await self.hand.jaw(self.settings.jaw_open_rad)
            await self.follow(0, replace(way, q=way.q[::-1]), self.settings.travel_speed_m_s)
            if self.tracker:
                await self.tracker.find()
        return "the jaws closed on nothing"


def _in_other(needle: NeedleEstimate, T_other_base: SE3) -> NeedleEstimate:
    """Return where the needle is in the base of the other arm."""
    return NeedleEstimate(T_other_base @ needle.T_base_needle, needle.covariance)
