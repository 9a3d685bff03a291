"""One arm drives sutures along the needle primitive (paper, III-C2 and section IV)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trocar.cell import Cell, GoalOffer
from trocar.errors import InvalidInput, MotionRefused
from trocar.eval import AgentContext
from trocar.robots.arm_script import ArmScript
from trocar.tasks.suture.agents.lost_needle import drive_on
from trocar.tasks.suture.agents.needle_tracker import Aim, NeedleTracker, Stretch, stretches
from trocar.tasks.suture.agents.paths import RUN_UP_INSIDE_M, RUN_UP_M, along, run_up
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import Suture
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.segments import (
    DRIVING_M_S,
    JAW_CLOSED_RAD,
    Segment,
    cut_short,
    ranges,
    retreat,
    suture_segments,
)

JOINED = 1e-3
"""A segment that starts within this distance (rad, m) of the arm's position continues from there."""
ENOUGH_M = 0.2e-3
"""If the needle's tip is estimated to be this close to its target, the arm does not move it and look again. The
threshold is multiplied by the number of looks so far, because each move disturbs the cables again, by some .4 mm."""
LOWERED = (1.0, 2 / 3, 1 / 3, 0.0)
"""Shares of the way down that are tried in turn, since its upper end matters least."""
TURNS, SHORT = ("rotate", "push"), (3, 6, 9, 12)
"""Steps that rotate the needle; if the corrected path leaves a joint's range, the arm tries to stop this many waypoints
(1 deg each) early. The next path starts from where the needle is seen, so it makes up for the rest."""
LOAD = "load needle"
"""A person's action: ``await assistants[LOAD](arm)`` puts the needle between the open jaws and holds it there until
they close."""


@dataclass(frozen=True)
class Settings:
    """How the agent works; lengths in m, angles in rad, times on the cell's clock in s.

    Attributes:
        planning_budget_s: declared time to plan the joint paths of a suture.
        two_arms_budget_s: declared time to plan what two arms do between the sutures, once a trial.
        settle_s: rest after a motion before the jaws act.
        driving_speed_m_s: mean speed of the jaws along the primitive, m/s; slow enough for the cables to take up their
            play before the needle's next movement.
        travel_speed_m_s: mean speed of two arms' jaws as they leave or lift the needle, or come to it, m/s.
        pulling_speed_m_s: mean speed at which a second arm pulls the needle through, m/s.
        jaw_open_rad: opening that clears the wire.
        jaw_closed_rad: target that lets the drive press.
        jaw_empty_rad: jaws that close further than this hold nothing; a wire of .9 mm keeps them open by .09.
        limits_share: share of the arms' limits of velocity and acceleration that is used from suture to suture.
        loadings: how often a person is asked to load the needle, until the jaws hold it as they should.
        images: number per look at the needle; 0: it is driven without looks.
        sighting_budget_s: declared time to find the needle in the images of a look.
        start_budget_s: declared time in addition for each further pose from which the needle is searched for.
    """

    planning_budget_s: float = 0.05
    two_arms_budget_s: float = 2.0
    settle_s: float = 0.1
    driving_speed_m_s: float = DRIVING_M_S
    travel_speed_m_s: float = 0.020
    pulling_speed_m_s: float = 0.010
    jaw_open_rad: float = JAW_OPEN_RAD
    jaw_closed_rad: float = JAW_CLOSED_RAD
    jaw_empty_rad: float = 0.04
    limits_share: float = 0.5
    loadings: int = 3
    images: int = 1
    sighting_budget_s: float = 0.12
    start_budget_s: float = 0.07


def blind() -> Settings:
    """Return the settings of an agent that does not look at the needle."""
    return Settings(images=0)


class End(NamedTuple):
    """How a suture ended, a sentence if it went wrong, and whether the arms have to stay where they are."""

    outcome: SutureOutcome
    reason: str = ""
    stops: bool = False


class CircleSuturing:
    """One arm drives one suture after the other; a person loads the needle before each."""

    pulls = False
    """Whether an arm pulls the needle through at the end, and so has to know where it is."""

    def __init__(self, context: AgentContext):
        cell, settings = context.cell, context.settings
        self.hand = ArmScript(cell, context.arms[0], settings.settle_s, settings.limits_share)
        self.require_help(cell)
        self.cell, self.log, self.clock, self.settings = cell, cell.log, cell.clock, settings
        self.arm, self.home = self.hand.model, self.hand.q
        planned = context.goals[0].setup
        circle = replace(planned.circle, T_world_circle=cell.T_world_fixture["circle"])
        base = cell.T_world_base_registered[self.hand.name]
        setup = replace(planned, arm=self.arm, T_world_base=base, circle=circle)
        self.sutures: list[Suture] = [replace(suture, setup=setup) for suture in context.goals]
        self.tracker = NeedleTracker(cell, self.hand, setup, settings) if settings.images else None

    def require_help(self, cell: Cell) -> None:
        """Raise InvalidInput unless somebody loads the needle."""
        if LOAD not in cell.assistants:
            raise InvalidInput("nobody in this cell", "loads the needle", f"give it an assistant for {LOAD!r}")

    async def begin(self) -> None:
        """Exercise the wrist and zero the jaws, before the first suture."""
        await self.hand.exercise_wrist()
        await self.hand.zero_jaw(self.settings.jaw_closed_rad)

    async def run(self) -> None:
        """Drive the sutures one after the other; if the plan itself leaves a joint's range, stop there for good."""
        await self.begin()
        left = list(enumerate(self.sutures))
        while left:
            offered = left[:1] if self.pulls else left  # the second arm holds out the needle as the next suture needs
            number, suture = left.pop(await self.cell.choose([self._offer(*one) for one in offered]))
            start_s = self.clock.now_s()
            outcome, reason, stops = await self._suture(number, suture)
            if not stops:
                await self.go_home()
            self.log.event(
                "suture",
                suture=number,
                theta_rad=suture.theta_rad,
                direction=suture.direction,
                start_s=round(start_s, 6),
                outcome=outcome.name,
                reason=reason,
            )
            if stops:
                self.log.event("stopped", outcome=outcome.name, reason=reason)
                return

    def _offer(self, number: int, suture: Suture) -> GoalOffer:
        """Return what a person is told of a suture that may be next."""
        path_m = suture.setup.circle.T_world_circle.apply(suture.needle_path_m)
        return GoalOffer(self.hand.name, f"drives suture {number + 1}, {suture}", path_m)

    async def go_home(self) -> None:
        """Go to where the arm began, in nobody's way."""
        await self.hand.go(self.home)

    async def _suture(self, number: int, suture: Suture) -> End:
        """Load, drive and release the needle; return how the suture ended.

        If only the corrections for cables and needle leave a joint's range, but not the plan, the suture is given up.
        """
        budget_s = self.settings.planning_budget_s
        *way_in, withdraw, rise = await self.hand.compute("planning", budget_s, lambda: suture_segments(suture))
        if failed := await self.take_needle(number):
            return failed
        path = [Stretch(segment) for segment in way_in]
        if self.tracker:
            path = stretches(way_in, suture.setup, to_the_end=self.pulls)
        for stretch in path:
            end = await self._stretch(number, stretch, suture, withdraw, rise)
            if end:
                return end
        return await self.finish(number, withdraw, rise)

    async def take_needle(self, number: int) -> End | None:
        """Have a person put the needle into the jaws; return the suture's end if the jaws do not hold it then."""
        if not await self._load():
            return missed(number, "the jaws did not hold the needle that they were given")
        if self.tracker:
            self.tracker.loaded()
        return None

    async def finish(self, number: int, withdraw: Segment, rise: Segment) -> End:
        """Let go of the needle, whose tip is out, and leave it to a person."""
        await self.open()
        await self.leave(number, withdraw, rise)
        return End(SutureOutcome.DONE)

    async def _stretch(self, number: int, stretch: Stretch, suture: Suture, *leaving: Segment) -> End | None:
        """Look, follow a stretch and close the jaws if they were open; return the suture's end, if it ended."""
        segment, tracker = stretch.segment, self.tracker
        if stretch.first:
            self.log.event("step", suture=number, step=segment.name)
        if segment.regrasps:  # open jaws hide less of the needle, which the tissue holds still
            await self.open()
        if tracker:
            await self.look(stretch, tracker)
            above = segment.name == "approach" and stretch.first
            if above and (failed := await self.check_needle(number, stretch, tracker)):
                return failed
            segment = tracker.path(stretch)
        if reason := await self._go_along(number, segment):
            if stretch.segment.first_outside(self.arm) is not None:
                return End(SutureOutcome.JOINT_LIMIT, reason, stops=True)
            await self.open()
            await self.leave(number, *retreat(suture.setup, self.hand.q))
            return End(SutureOutcome.JOINT_LIMIT, reason)
        if segment.regrasps:
            return await self._regrip(number, stretch, *leaving)
        lost = tracker and segment.name.startswith(TURNS) and self.hand.jaw_rad <= self.settings.jaw_empty_rad
        if lost and not await drive_on(self, number, stretch.segment):
            await self.leave(number, *leaving)
            return missed(number, f"the jaws lost the needle in {segment.name}")
        return None

    async def _regrip(self, number: int, stretch: Stretch, *leaving: Segment) -> End | None:
        """Close the jaws on the needle in the tissue; return the suture's end if they missed it."""
        tracker = self.tracker
        if stretch.looks and tracker:
            await tracker.look()
        if not (await self.grip() or (tracker and await self._grip_again(stretch, tracker))):
            await self.hand.jaw(self.settings.jaw_open_rad)
            await self.leave(number, *leaving)
            return missed(number, f"the jaws closed on nothing after {stretch.segment.name}")
        if tracker:
            tracker.gripped()
        return None

    async def _grip_again(self, stretch: Stretch, tracker: NeedleTracker) -> bool:
        """Find the needle, which the jaws missed, and close them where it is; return whether they hold it."""
        await self.hand.jaw(self.settings.jaw_open_rad)
        if not await tracker.find():
            return False
        segment = stretch.segment
        try:
            await self.hand.go(tracker.corrected(segment.first(len(segment.q) - segment.beyond)).q[-1])
        except MotionRefused:
            return False
        return await self.grip()

    async def _load(self) -> bool:
        """Have a person put the needle into the jaws; return whether they hold it."""
        for _ in range(self.settings.loadings):
            await self.hand.jaw(self.settings.jaw_open_rad)
            with self.log.span(self.hand.name, "loading"):
                await self.cell.assistants[LOAD](self.hand.name)
            if await self.grip():
                return True
        return False

    async def check_needle(self, number: int, stretch: Stretch, tracker: NeedleTracker) -> End | None:
        """Have the needle loaded again if it is not seen in the jaws, or if its pose is too bad for driving."""
        for _ in range(self.settings.loadings - 1):
            if tracker.well_loaded:
                break
            self.log.event("loaded anew")
            tracker.forget()
            if await self._load():
                tracker.loaded()
                await self.look(stretch, tracker)
        return None

    async def look(self, stretch: Stretch, tracker: NeedleTracker) -> None:
        """Look at the needle before a stretch and, if another look is allowed, go to where it should be."""
        for number in range(stretch.looks):
            doubted = await tracker.look()
            if stretch.looks == 1:
                return
            if doubted:
                continue
            tracker.aim(stretch)
            path = tracker.corrected(stretch.segment).q
            start = path[:1].ravel()
            shift_m = tracker.tip_shift_m(start) if len(start) and np.isfinite(path).all() else 0.0
            if shift_m < (number + 1) * ENOUGH_M:
                return
            try:
                if stretch.aim is Aim.TIP:
                    back_m = RUN_UP_M if stretch.fixed_wrist else RUN_UP_INSIDE_M
                    await self.hand.go(run_up(path, stretch.segment.length_m, back_m))
                await self.hand.go(start)
            except MotionRefused:  # a joint's range ends there; following the path will report it
                return

    async def open(self) -> None:
        """Open the jaws on the needle, which the tissue holds meanwhile."""
        if self.tracker:
            self.tracker.released()
        await self.hand.jaw(self.settings.jaw_open_rad)

    async def grip(self) -> bool:
        """Close the jaws; return whether they stalled on a wire."""
        await self.hand.settle()
        await self.hand.jaw(self.settings.jaw_closed_rad)
        await self.hand.settle()
        return self.hand.jaw_rad > self.settings.jaw_empty_rad

    async def _go_along(self, number: int, segment: Segment) -> str:
        """Follow a segment, and come back to its end if it goes beyond; return a sentence if the arm cannot."""
        if segment.name == "lower":
            return await self._lower(number, segment)
        reason = await self.follow(number, segment)
        if reason and self.tracker and segment.name.startswith(TURNS) and segment.first_outside(self.arm) is None:
            for missing in SHORT:
                shorter = segment.first(max(0, len(segment.q) - missing))
                if len(shorter.q) > 1 and not await self.follow(number, shorter):
                    return ""
        return await self.follow(number, segment.back) if segment.beyond and not reason else reason

    async def _lower(self, number: int, segment: Segment) -> str:
        """Come down along a segment, from as far up as possible; return a sentence if it is impossible."""
        reason = ""
        for left in LOWERED:
            q = segment.q[round((1.0 - left) * (len(segment.q) - 1)) :]
            reason = await self.follow(number, replace(segment, q=q, length_m=left * segment.length_m))
            if not reason:
                break
        return reason

    async def leave(self, number: int, *planned: Segment) -> None:
        """Retreat along the planned way out, shifted to where the jaws let go, as far as possible.

        Corrections for the needle do not apply to empty jaws. The shifted path is cut short like the planned one.
        """
        off = self.hand.q - next((segment.q[0] for segment in planned if len(segment.q)), self.hand.q)
        from_here = [replace(segment, q=segment.q + off) for segment in planned]
        for segment in cut_short(from_here, self.arm):
            self.log.event("step", suture=number, step=segment.name)
            if len(segment.q) and await self.follow(number, segment):
                return

    async def follow(self, number: int, segment: Segment, speed_m_s: float | None = None) -> str:
        """Move along a segment, as far as the joints' ranges allow; return a sentence if they do not."""
        outside = segment.first_outside(self.arm)
        q = segment.q if outside is None else segment.q[: outside[0]]
        reason = "" if outside is None else self._limit(number, segment, *outside)
        mean_m_s = speed_m_s or segment.free_m_s or self.settings.driving_speed_m_s
        seconds = segment.length_m / mean_m_s * len(q) / max(1, len(segment.q))
        try:
            if len(q) and np.abs(q[0] - self.hand.q).max() > JOINED:
                await self.hand.go(q[0])
            if len(q) > 1:
                await self.hand.move(along(np.concatenate([self.hand.q[None], q[1:]]), seconds))
        except MotionRefused as error:
            return f"suture {number + 1}, {segment.name}: {error}; stopped before it"
        return reason

    def _limit(self, number: int, segment: Segment, waypoint: int, joint: int) -> str:
        """Return in words what a path demands of a joint that is out of its range."""
        where = f"suture {number + 1}, {segment.name}"
        if joint < 0:
            return f"{where}: no configuration of {self.arm.name} reaches waypoint {waypoint} of {len(segment.q)}"
        limits, values = self.arm.joints[joint], segment.q[waypoint:, joint]
        lower, upper = (float(bound[joint]) for bound in ranges(self.arm))
        lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
        wanted = lowest if lower - lowest > highest - upper else highest
        return (
            f"{where}: joint '{limits.name}' would go to {limits.shown(wanted)}, outside "
            f"[{limits.shown(lower)}, {limits.shown(upper)}]; stopped there"
        )


def missed(number: int, why: str) -> End:
    """Return the end of a suture whose needle the jaws did not get."""
    return End(SutureOutcome.NEEDLE_MISSED, f"suture {number + 1}: {why}")
