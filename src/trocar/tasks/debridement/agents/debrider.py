"""The script of one arm: brings one fragment after another into the receptacle (Kehoe 2014, V-C)."""

from __future__ import annotations

from functools import partial

import trio

from trocar.robots.concurrency import together
from trocar.tasks.debridement.agents.eyes import CameraFrozen
from trocar.tasks.debridement.agents.fleet import Failure, Fleet
from trocar.tasks.debridement.agents.letting_go import WAYS, try_to_shed
from trocar.tasks.debridement.agents.movers import ArmStopped, NoWay
from trocar.tasks.debridement.agents.places import Grasp
from trocar.tasks.debridement.agents.raven_arm import RavenArm
from trocar.tasks.debridement.agents.searching import come_into_sight
from trocar.tasks.debridement.outcomes import FragmentOutcome
from trocar.tasks.debridement.perception.seen import SeenFragment

TOO_MANY = 8
"""An arm that fails this many times in a row gives up."""
LIFTED_SHARE = 0.8
"""Jaws that have risen by this share of their lift have left the work surface."""
SHORT_S = 0.05
IDLE_S = 5.0
"""An idle arm looks again after this time, or once the other one has made progress."""


class GiveUp(Exception):
    """An arm goes home because a person has to do something first.

    Attributes:
        outcome: what is to be done.
    """

    def __init__(self, outcome: FragmentOutcome, what_to_do: str):
        super().__init__(what_to_do)
        self.outcome = outcome


class NothingHeld(Exception):
    """The jaws closed on nothing, or lost the fragment."""


class Debrider:
    """The script of one arm.

    Args:
        arm: with its actions.
        fleet: state shared with the other arm.
    """

    def __init__(self, arm: RavenArm, fleet: Fleet):
        self.arm, self.fleet, self.places = arm, fleet, arm.places
        self.cell, self.name, self.s = arm.cell, arm.name, arm.s
        self.side = fleet.sides[arm.name]
        self._began_s, self._in_a_row = 0.0, 0
        self._is_home = self._looked_again = False

    async def run(self) -> None:
        """Clear fragments until there are none, or none within reach."""
        self.fleet.busy.add(self.name)
        try:
            await come_into_sight(self.arm)
            while await self._one_more():
                pass
            await self._home()
            self.fleet.give(self.name, None)
        except ArmStopped as stop:  # where it is now, it blocks the other arm
            self.fleet.give(self.name, self.arm.robot.T_world_tip(self.name).translation_m)
            self.note(FragmentOutcome.ARM_STOPPED, str(stop))
        except GiveUp as end:
            self.note(end.outcome, str(end))
            await self._home()
            self.fleet.give(self.name, None)
        finally:
            self.fleet.busy.discard(self.name)
            self.fleet.change()
            self.arm.mover.resting(self.name).__enter__()

    async def _one_more(self) -> bool:
        """Clear one fragment, or wait for one; return whether there may be more."""
        if self._in_a_row >= TOO_MANY or (self.fleet.cleared >= self.fleet.goals and await self._all_cleared()):
            return False
        self._began_s = self.cell.clock.now_s()
        found = await self._allocated()
        if found is None:
            return await self._wait()
        fragment, grasp = found
        try:
            outcome, reason = await self._clear(fragment, grasp)
        except NoWay as error:
            outcome, reason = FragmentOutcome.BLOCKED, str(error)
            await self._back()
        self._in_a_row = 0 if outcome is FragmentOutcome.DONE else self._in_a_row + 1
        if outcome is not FragmentOutcome.DONE:
            blocked = outcome is FragmentOutcome.BLOCKED
            self.fleet.failures.append(Failure(self.name, fragment.p_world_m, self.cell.clock.now_s(), blocked))
        self.note(outcome, reason)
        self.fleet.give(self.name, None)
        return True

    async def _all_cleared(self) -> bool:
        """Look once more when all should be cleared, beside the work surface; return whether nothing is left to do."""
        await self._home()
        while self._others_at_work():  # and may leave one behind that only this arm reaches
            await self._other_goes_on()
        look = await self.arm.eyes.look(self.name)
        left = len(self.fleet.loose([*look.fragments, *look.hidden]))
        self.fleet.cleared = self.fleet.known.fragments - left
        return self.fleet.cleared >= self.fleet.goals

    async def _allocated(self) -> tuple[SeenFragment, Grasp] | None:
        """Look, and claim the outermost fragment within reach, or the last one if it is nearer."""
        if self._enough():
            return None
        if self.s.vision_lag_s > 0:
            with self.cell.log.span(self.name, "perception"):
                await self.cell.clock.sleep(self.s.vision_lag_s)
        look = await self.arm.eyes.look(self.name)
        if self.fleet.full(look.fragments, [self.arm.robot.T_world_tip(n).translation_m for n in self.cell.arms]):
            raise GiveUp(FragmentOutcome.RECEPTACLE_FULL, "fragments stand out of the receptacle; empty it")
        seen, hidden, now_s = self.fleet.loose(look.fragments), self.fleet.loose(look.hidden), self.cell.clock.now_s()
        loose = [*seen, *hidden]
        choices = [self.fleet.choice(self.name, part, self.s.apart_m, now_s) for part in (seen, hidden)]
        for fragment in [*choices[0], *choices[1]]:
            others = [f for f in loose if f is not fragment]
            grasps = self.places.grasps(fragment, others, self.arm.model, self.arm.turn_rad)
            again = self.fleet.failures_at(fragment.p_world_m) % len(grasps)
            grasp = self.arm.possible([*grasps[again:], *grasps[:again]])  # a different way from the one that failed
            if grasp is None:
                continue
            if self._enough():  # while this arm looked, the other one has claimed one
                return None
            self.fleet.give(self.name, fragment.p_world_m)
            self.cell.log.event("allocated", arm=self.name, place=fragment.p_world_m.tolist())
            return fragment, grasp
        if loose and not self.fleet.busy - {self.name}:
            where = ", ".join(f"({1e3 * f.p_world_m[0]:.0f}, {1e3 * f.p_world_m[1]:.0f}) mm" for f in loose)
            self.note(FragmentOutcome.OUT_OF_REACH, f"no grasp at {where} is within reach")
        return None

    def _enough(self) -> bool:
        """Return whether the other arm's fragment is the last that is to be cleared."""
        return self.fleet.cleared + len(self._others_at_work()) >= self.fleet.goals

    def _others_at_work(self) -> set[str]:
        """Return the other arms that have claimed a fragment and are still working."""
        return (self.fleet.busy - {self.name}) & self.fleet.taken.keys()

    async def _wait(self) -> bool:
        """Let the other arm continue; return whether to look again."""
        if not self._others_at_work():
            if self._is_home or self._looked_again:
                return False
            self._looked_again = True  # from home, because this arm may have hidden one
            await self._home()
            return True
        await self._home()
        await self._other_goes_on()
        return True

    async def _other_goes_on(self) -> None:
        """Return when the other arm has made progress, or after a while."""
        with self.cell.log.span(self.name, "waiting"), self.arm.mover.resting(self.name):
            with trio.move_on_after(IDLE_S):
                await self.fleet.changed()

    async def _clear(self, fragment: SeenFragment, grasp: Grasp) -> tuple[FragmentOutcome, str]:
        """Take a fragment and bring it into the receptacle; return how that ended."""
        self._is_home = self._looked_again = False
        await self.arm.take(grasp)
        self.arm.eyes.memory.take(self.name, fragment.p_world_m)
        try:
            if self.s.lifts_on_the_way:
                await together(self._check_lifted, partial(self._bring, self.s.lift_m))
            else:
                await self.arm.rise(self.s.lift_m)
                self.fleet.carry(self.name)
                await self._check()
                await self._bring()
            return await self._let_go()
        except NothingHeld:
            await self.arm.jaw(grasp.open_rad)
            return FragmentOutcome.GRASP_FAILURE, "no fragment was seen in the jaws after they closed"
        finally:
            self.arm.eyes.memory.let_go(self.name)
            self.fleet.token.drop(self.name)

    async def _check(self) -> None:
        """Look whether the jaws hold a fragment.

        Raises:
            NothingHeld: they do not.
        """
        if not await self.arm.eyes.holds(self.name):
            raise NothingHeld

    async def _check_lifted(self) -> None:
        """Look whether the jaws hold a fragment once they have risen with it, while moving on.

        Raises:
            NothingHeld: they do not.
        """
        from_m = self.arm.height_m
        while self.arm.height_m < from_m + LIFTED_SHARE * self.s.lift_m:
            await self.cell.clock.sleep(SHORT_S)
        self.fleet.carry(self.name)
        await self._check()

    async def _bring(self, lift_m: float = 0.0) -> None:
        """Go over the receptacle, first straight up by this height; the arm then has the receptacle's token."""
        if self.s.holds_first or not self.fleet.token.take_now(self.name):
            await self.arm.go_to_one(self.places.hold(self.side, self.arm.turn_rad), lift_m)
            with self.cell.log.span(self.name, "waiting"), self.arm.mover.resting(self.name):
                await self.fleet.token.take(self.name)
            lift_m = 0.0
        await self.arm.go_to_one(self.places.drop(self.side, self.arm.turn_rad), lift_m)

    async def _let_go(self) -> tuple[FragmentOutcome, str]:
        """Open the jaws over the receptacle, and shake off what clings to them."""
        self.cell.log.event("releasing", arm=self.name)
        await self.arm.jaw(self.s.open_rad)
        for number in range(WAYS + 1):
            if not self.s.checks_release or not await self.arm.eyes.clings(self.name):
                self.fleet.cleared += 1
                return FragmentOutcome.DONE, ""
            if number < WAYS:
                await try_to_shed(self.arm, number)
        raise GiveUp(FragmentOutcome.STUCK_IN_JAWS, "a fragment clings to the open jaws; take it off")

    async def _back(self) -> None:
        """Open the jaws where the arm is, and move aside as far as possible."""
        try:
            await self.arm.jaw(self.s.open_rad)
            await self.arm.go_to_one(self.places.hold(self.side, self.arm.turn_rad))
        except NoWay:
            self.cell.log.event("stayed", arm=self.name)

    async def _home(self) -> None:
        """Move out of the other arm's way, if not there already."""
        if self._is_home:
            return
        try:
            await self.arm.go_to_one(self.places.home(self.side, self.arm.turn_rad))
            self._is_home = True
        except NoWay:
            self.cell.log.event("stayed", arm=self.name)

    def note(self, outcome: FragmentOutcome, reason: str) -> None:
        """Note how the handling of a fragment ended."""
        self.cell.log.event(
            "fragment", arm=self.name, outcome=outcome.name, reason=reason, start_s=round(self._began_s, 6)
        )


async def work(debriders: list[Debrider]) -> None:
    """Run the scripts of all arms; a camera failure ends them all, wherever they are."""
    frozen: list[CameraFrozen] = []

    async def one(debrider: Debrider, nursery: trio.Nursery) -> None:
        try:
            await debrider.run()
        except CameraFrozen as error:
            frozen.append(error)
            nursery.cancel_scope.cancel()

    async with trio.open_nursery() as nursery, trio.open_nursery() as watchers:

        async def watch(debrider: Debrider) -> None:
            try:
                await debrider.arm.eyes.watch(debrider.name)
            except CameraFrozen as error:
                frozen.append(error)
                nursery.cancel_scope.cancel()

        for debrider in debriders:
            watchers.start_soon(watch, debrider)
        async with trio.open_nursery() as scripts:
            for debrider in debriders:
                scripts.start_soon(one, debrider, nursery)
        watchers.cancel_scope.cancel()
    if frozen:
        for debrider in debriders:
            debrider.note(FragmentOutcome.CAMERA_FROZEN, str(frozen[0]))
