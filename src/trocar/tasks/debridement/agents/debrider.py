"""The script of one arm: brings one fragment after another into the receptacle (Kehoe 2014, V-C)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import numpy as np
import trio

from trocar.cell import GoalOffer
from trocar.errors import ArmStopped, TrocarError
from trocar.geometry import SE3
from trocar.robots.concurrency import Pending, together
from trocar.tasks.debridement.agents.allocation import Allocation, Failure
from trocar.tasks.debridement.agents.motions import NoMotion
from trocar.tasks.debridement.agents.observer import CameraFrozen, Observation
from trocar.tasks.debridement.agents.places import Grasp
from trocar.tasks.debridement.agents.raven_arm import WAYS, RavenArm
from trocar.tasks.debridement.goals import FragmentOutcome
from trocar.tasks.debridement.perception.fragments import SeenFragment

TOO_MANY = 8  # an arm that fails this many times in a row gives up
LIFTED_SHARE = 0.8  # jaws that have risen by this share of their lift have left the work surface
CLEAR_M = 0.031
"""From a tip this high over the work surface, a look at the jaws no longer shows what may have stayed below them: it
reaches 18 mm down from the tip, and fragments are up to 12 mm high."""
SHORT_S = 0.05
RECEPTACLE = "receptacle"  # with a token, the space over the receptacle is for one arm at a time (V-C.2)
INSIDE_M = 0.014
"""Jaws open on their way over the receptacle once the tip is this far from its walls; it goes on inwards meanwhile.
Fragments are up to 16 mm long."""
PARTED_RAD = 0.5  # jaws let a fragment go by opening this far; they open as the next one needs on the way to it
LOOK_S = 0.12  # from the release to the look for the next fragment, which is evaluated before the jaws have parted
FRESH_S = 0.8  # a look at the release of a fragment serves to choose the next one for this long
IDLE_S = 5.0  # an idle arm looks again after this time, or once the other one has made progress


class GiveUp(Exception):
    """An arm goes home because a person has to do something first: (outcome, what to do)."""


class NothingHeld(Exception):
    """The jaws closed on nothing, or lost the fragment."""


class Clings(Exception):
    """The last fragment hangs from the open jaws, which are on their way to the next one."""


class Debrider:
    """The script of one arm, with its actions and the allocation that all arms share."""

    def __init__(self, arm: RavenArm, allocation: Allocation):
        self.arm, self.allocation, self.places = arm, allocation, arm.places
        self.coordinator = allocation.coordinator
        self.cell, self.name, self.s = arm.cell, arm.name, arm.s
        self._began_s, self._in_a_row, self._changes = 0.0, 0, 0
        self._is_home = self._looked_again = self._has_arrived = False
        # Whether the last fragment clings, or why that is unknown.
        self._parted: Pending[bool | TrocarError] = Pending()
        self._released_of_s = 0.0  # when the handling of that fragment began
        self._look: tuple[float, int, Observation] | None = None  # when, how many had been taken, and what it showed

    async def run(self, helpers: trio.Nursery) -> None:
        """Clear fragments until there are none, or none within reach."""
        self._helpers = helpers
        self.allocation.busy.add(self.name)
        try:
            observed = await self.arm.come_into_sight()
            if self.s.flows:
                self._keep(observed)
            try:
                while await self._one_more():
                    pass
            except GiveUp as end:
                self.note(*end.args)
            await self._home()
            self.allocation.claim(self.name, None)
        except ArmStopped as stop:  # a stopped arm blocks the other one
            self.allocation.claim(self.name, self.arm.robot.T_world_tip(self.name).translation_m)
            self.note(FragmentOutcome.ARM_STOPPED, str(stop))
        finally:
            self.allocation.busy.discard(self.name)
            self.coordinator.progress()
            self.coordinator.leave(self.name)

    async def _one_more(self) -> bool:
        """Clear one fragment, or wait for one; return whether there may be more."""
        if self._in_a_row >= TOO_MANY:
            return False
        if self.allocation.cleared >= self.allocation.goals:
            await self._confirm_release()
            if await self._all_cleared():
                return False
        self._began_s = self.cell.clock.now_s()
        found = await self._allocated()
        if found is None:
            await self._confirm_release()
            return await self._wait()
        fragment, grasp = found
        try:
            outcome, reason = await self._clear(fragment, grasp)
        except Clings:
            self.allocation.claim(self.name, None)
            await self._confirm_release()
            return True
        except NoMotion as error:
            outcome, reason = FragmentOutcome.BLOCKED, str(error)
            await self.arm.jaw(self.s.open_rad)
            await self._aside(self.places.hold(self.arm.side, self.arm.turn_rad))
        self._in_a_row = 0 if outcome is FragmentOutcome.DONE else self._in_a_row + 1
        if outcome is FragmentOutcome.DONE:
            self.allocation.cleared += 1  # unless it clings: see `_confirm_release`
            self._released_of_s = self._began_s
            if not self.s.flows:
                await self._confirm_release()
        else:
            blocked = outcome is FragmentOutcome.BLOCKED
            self.allocation.failures.append(Failure(self.name, fragment.p_world_m, self.cell.clock.now_s(), blocked))
            self.note(outcome, reason)
        self.allocation.claim(self.name, None)
        return True

    async def _all_cleared(self) -> bool:
        """Go home and look once more when all should be cleared; return whether nothing is left to do."""
        await self._home()
        while self._others_at_work():  # they may leave one behind that only this arm reaches
            await self._other_goes_on()
        observed = await self.arm.observer.observe(self.name)
        left = len(self.allocation.loose([*observed.fragments, *observed.hidden]))
        self.allocation.cleared = self.allocation.workspace.fragments - left
        return self.allocation.cleared >= self.allocation.goals

    async def _allocated(self) -> tuple[SeenFragment, Grasp] | None:
        """Look, and claim the outermost fragment within reach; return it with a grasp, or None."""
        self._changes = self.allocation.changes
        if self._enough():
            return None
        if self.s.vision_lag_s > 0:
            with self.cell.log.span(self.name, "perception"):
                await self.cell.clock.sleep(self.s.vision_lag_s)
        observed = await self._observed()
        tips = [self.arm.robot.T_world_tip(name).translation_m for name in self.cell.arms]
        if self.allocation.full(observed.fragments, tips):
            await self._confirm_release()
            raise GiveUp(FragmentOutcome.RECEPTACLE_FULL, "fragments stand out of the receptacle; empty it")
        loose = [*self.allocation.loose(observed.fragments), *self.allocation.loose(observed.hidden)]
        now_s, untried, s = self.cell.clock.now_s(), loose, self.s
        while choices := self.allocation.choices(self.name, self.arm.side, untried, s.apart_m, now_s, s.ahead):
            changes = self.allocation.changes
            fragment = choices[await self.cell.choose([self._offer(choice) for choice in choices])]
            if self.allocation.changes != changes:  # while a person chose, the other arm has claimed one
                continue
            untried = [f for f in untried if f is not fragment]
            others = [f for f in loose if f is not fragment]
            failures = self.allocation.failures_at(fragment.p_world_m)
            grasps = self.places.grasps(fragment, others, self.arm.model, self.arm.turn_rad, failures)
            grasp = self.arm.possible(grasps)
            if grasp is None:
                continue
            if self._enough():  # while this arm looked, the other one has claimed one
                return None
            self.allocation.claim(self.name, fragment.p_world_m)
            self.cell.log.event("allocated", arm=self.name, place=fragment.p_world_m.tolist())
            return fragment, grasp
        if loose and not self.allocation.busy - {self.name}:
            where = ", ".join(f"({1e3 * f.p_world_m[0]:.0f}, {1e3 * f.p_world_m[1]:.0f}) mm" for f in loose)
            self.note(FragmentOutcome.OUT_OF_REACH, f"no grasp at {where} is within reach")
        return None

    def _offer(self, fragment: SeenFragment) -> GoalOffer:
        """Return what a person is told of a fragment that this arm may take."""
        x_mm, y_mm = 1e3 * fragment.p_world_m[:2]
        path_m = np.array([fragment.p_world_m, self.allocation.T_world_receptacle.translation_m])
        return GoalOffer(self.name, f"takes the fragment at ({x_mm:.0f}, {y_mm:.0f}) mm", path_m)

    async def _observed(self) -> Observation:
        """Return what the look at the last release showed, unless it is old or a fragment was taken since, or look."""
        look, self._look = self._look, None
        if look is None or self.cell.clock.now_s() - look[0] > FRESH_S or look[1] != self.arm.observer.memory.taken:
            return await self.arm.observer.observe(self.name)
        return look[2]

    def _enough(self) -> bool:
        """Return whether the fragments that other arms have claimed are the last to be cleared."""
        return self.allocation.cleared + len(self._others_at_work()) >= self.allocation.goals

    def _others_at_work(self) -> set[str]:
        """Return the other arms that have claimed a fragment and are still working."""
        return (self.allocation.busy - {self.name}) & self.allocation.claimed.keys()

    async def _wait(self) -> bool:
        """Let the other arm continue; return whether to look again."""
        if not self._others_at_work():
            if self._is_home or self._looked_again:
                return False
            self._looked_again = True  # from home, because this arm may have hidden one
            await self._home()
            return True
        await self._home()
        if not self.s.flows or self.allocation.changes == self._changes:
            await self._other_goes_on()
        return True

    async def _other_goes_on(self) -> None:
        """Return when the other arm has made progress, or after a while."""
        with self.cell.log.span(self.name, "waiting"), self.coordinator.idle(self.name):
            with trio.move_on_after(IDLE_S):
                await self.coordinator.progressed()

    async def _clear(self, fragment: SeenFragment, grasp: Grasp) -> tuple[FragmentOutcome, str]:
        """Take a fragment and bring it into the receptacle; return how that ended."""
        self._is_home = self._looked_again = False
        await together(self._require_released, partial(self.arm.reach, grasp))
        try:
            if self.s.flows:
                lift_and_bring = partial(self._lift_and_bring, fragment, grasp)
                await together(self.arm.close, self._check_and_open, lift_and_bring)
            else:
                await self.arm.close()
                self.arm.observer.memory.take(self.name, fragment.p_world_m)
                await self.arm.rise(self.s.lift_m)
                self.allocation.carry(self.name)
                await self._check()
                await self._bring()
                await self._open(self.s.open_rad)
                self._parted.put(False)  # the paper's program did not look
            return FragmentOutcome.DONE, ""
        except NothingHeld:
            await self.arm.jaw(grasp.open_rad)
            return FragmentOutcome.GRASP_FAILURE, "no fragment was seen in the jaws after they closed"
        finally:
            self.arm.observer.memory.let_go(self.name)
            self.coordinator.release(self.name, RECEPTACLE)

    async def _lift_and_bring(self, fragment: SeenFragment, grasp: Grasp) -> None:
        """Bring a fragment over the receptacle as soon as the jaws have closed on it; the plan is made meanwhile."""
        closing_s = grasp.open_rad / self.arm.model.jaw.max_speed
        await self.cell.clock.sleep(max(0.0, closing_s - self.s.plan_budget_s))
        self.arm.observer.memory.take(self.name, fragment.p_world_m)
        await self._bring(self.s.lift_m)

    async def _check(self) -> None:
        """Look whether the jaws, which have risen, hold a fragment.

        Raises:
            NothingHeld: they do not.
        """
        if not await self.arm.observer.holds(self.name):
            raise NothingHeld

    async def _check_and_open(self) -> None:
        """Check once the jaws have risen with the fragment, and open them over the receptacle, while moving on."""
        self._has_arrived = False
        await self._risen_to(self.arm.height_m + LIFTED_SHARE * self.s.lift_m)
        self.allocation.carry(self.name)
        await self._risen_to(self.places.table_m + CLEAR_M)
        await self._check()
        while not (self._has_arrived or self._is_over()):
            await self.cell.clock.sleep(SHORT_S)
        self._parted.start(self._helpers, self._part)
        await self._look_ahead()
        if self.s.token:  # which is returned once the jaws have parted
            self._parted.put(await self._parted.take())

    async def _risen_to(self, height_m: float) -> None:
        """Wait until the tip is this high in the world, or where the jaws open."""
        while not self._has_arrived and self.arm.height_m < height_m:
            await self.cell.clock.sleep(SHORT_S)

    def _is_over(self) -> bool:
        """Return whether the tip is over the receptacle, high enough, and the arm may let go there.

        Lower, a look at the open jaws would show what lies below them.
        """
        tip = self.arm.robot.T_world_tip(self.name).translation_m
        is_there = self.allocation.over_receptacle(tip, INSIDE_M) and float(tip[2]) > self.places.table_m + CLEAR_M
        return is_there and (not self.s.token or self.coordinator.try_reserve(self.name, RECEPTACLE))

    async def _look_ahead(self) -> None:
        """Look for the next fragment a little after the release: further out, the arm hides more of them."""
        await self.cell.clock.sleep(LOOK_S)
        self._keep(await self.arm.observer.observe(self.name))

    def _keep(self, observed: Observation) -> None:
        """Keep what a look showed for the choice of the next fragment."""
        self._look = self.cell.clock.now_s(), self.arm.observer.memory.taken, observed

    async def _part(self) -> bool | TrocarError:
        """Part the jaws over the receptacle; return whether the fragment is then seen to cling to them.

        Meanwhile the arm may set out for the next one, which opens the jaws further.
        """
        try:
            await self._open(min(self.arm.robot.read(self.name).jaw_rad + PARTED_RAD, self.s.open_rad))
            return await self.arm.observer.clings(self.name)
        except TrocarError as error:  # raised again by whoever takes the answer
            return error

    async def _released(self) -> bool | None:
        """Return whether the last fragment has left the jaws, once that is known; None if it was noted before."""
        clings = await self._parted.take()
        if isinstance(clings, TrocarError):
            raise clings
        if clings is False:
            self.note(FragmentOutcome.DONE, "", self._released_of_s)
        return None if clings is None else not clings

    async def _require_released(self) -> None:
        """Raise Clings if the last fragment hangs from the jaws."""
        if await self._released() is False:
            self._parted.put(True)
            raise Clings

    async def _confirm_release(self) -> None:
        """Wait until it is known whether the last fragment has left the jaws; shake it off if not."""
        if await self._released() is False:
            self.allocation.cleared -= 1
            await self._shake_off()
            self.allocation.cleared += 1
            self.note(FragmentOutcome.DONE, "", self._released_of_s)

    async def _bring(self, lift_m: float = 0.0) -> None:
        """Go over the receptacle, first straight up by this height; with a token, wait beside it until it is free."""
        if self.s.token:
            await self.arm.go_to_one(self.places.hold(self.arm.side, self.arm.turn_rad), lift_m)
            with self.cell.log.span(self.name, "waiting"), self.coordinator.idle(self.name):
                await self.coordinator.reserve(self.name, RECEPTACLE)
            lift_m = 0.0
        enough = (self._is_over,) if self.s.flows else ()
        await self.arm.go_to_one(self.places.drop(self.arm.side, self.arm.turn_rad), lift_m, *enough)
        self._has_arrived = True

    async def _open(self, angle_rad: float) -> None:
        """Open the jaws over the receptacle."""
        self.cell.log.event("releasing", arm=self.name)
        await self.arm.jaw(angle_rad)

    async def _shake_off(self) -> None:
        """Shake off what clings to the open jaws."""
        clings = await self.arm.observer.clings(self.name)  # it may have hung there for a moment
        for number in range(WAYS):
            if not clings:
                return
            await self.arm.shed(number)
            clings = await self.arm.observer.clings(self.name)
        if clings:
            self._began_s = self._released_of_s
            raise GiveUp(FragmentOutcome.STUCK_IN_JAWS, "a fragment clings to the open jaws; take it off")

    async def _home(self) -> None:
        """Move out of the other arm's way, if not there already."""
        if not self._is_home:
            self._is_home = await self._aside(self.places.home(self.arm.side, self.arm.turn_rad))

    async def _aside(self, places: list[SE3]) -> bool:
        """Go to one of these places, if there is a path; return whether the arm is there."""
        try:
            await self.arm.go_to_one(places)
        except NoMotion:
            self.cell.log.event("stayed", arm=self.name)
            return False
        return True

    def note(self, outcome: FragmentOutcome, reason: str, began_s: float | None = None) -> None:
        """Note how the handling of a fragment ended, which began then, or else with the present one."""
        start_s = round(self._began_s if began_s is None else began_s, 6)
        self.cell.log.event("fragment", arm=self.name, outcome=outcome.name, reason=reason, start_s=start_s)


async def run_all(debriders: list[Debrider]) -> None:
    """Run the scripts of all arms, and follow their grippers; a camera failure ends them all, wherever they are."""
    frozen: list[CameraFrozen] = []

    async def seeing(what: Callable[..., Awaitable[None]], *args: Any) -> None:
        try:
            await what(*args)
        except CameraFrozen as error:
            frozen.append(error)
            nursery.cancel_scope.cancel()

    async with trio.open_nursery() as nursery, trio.open_nursery() as watchers:
        for debrider in debriders:
            watchers.start_soon(seeing, debrider.arm.observer.follow, debrider.name)
        async with trio.open_nursery() as scripts:
            for debrider in debriders:
                scripts.start_soon(seeing, debrider.run, watchers)
        watchers.cancel_scope.cancel()
    if frozen:
        for debrider in debriders:
            debrider.note(FragmentOutcome.CAMERA_FROZEN, str(frozen[0]))
