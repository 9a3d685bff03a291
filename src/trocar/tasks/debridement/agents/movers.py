"""Planning and starting the motions of several arms: each around the others, or all at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import trio

from trocar.arms import fk
from trocar.arms.solids import SOLIDS
from trocar.cell import Cell, MotionEnd
from trocar.errors import AlreadyThere, NoPlan, TrocarError
from trocar.motion import MotionPlan, plan_motion
from trocar.motion.planners import Planner
from trocar.tasks.debridement.agents.adjusted import STEP_ENDED, Adjusted
from trocar.tasks.debridement.agents.motion_asked import Asked, Problems
from trocar.tasks.debridement.agents.settings import Settings
from trocar.trajectory import Trajectory

WAIT_S = 0.25
"""Pause of an arm that finds no path before it tries again; the other one moves on meanwhile."""
PATH_STEP_S = 0.05
LEAST_WAIT_S, MOST_WAIT_S = 0.01, 0.1
"""Interval between two checks of how long an arm has until it is to be stopped."""
TOO_NEAR = "comes within"
"""Part of the reason that a guard gives if it refuses to bring arms closer to each other."""


class ArmStopped(Exception):
    """An arm did not reach the end of its motion."""


class NoWay(Exception):
    """No plan was found, or the robot refused it.

    Attributes:
        lasting: only other estimates would help, because no other arm is in the way.
        begins_too_near: the arm is estimated to be already too close to something.
    """

    def __init__(self, reason: str, lasting: bool = False):
        super().__init__(reason)
        self.lasting = lasting
        self.begins_too_near = "at the start" in reason


class Mover(Protocol):
    """Moves an arm one step along its path, from the newest estimate."""

    async def step(self, arm: str, asked: Asked, way_m: float) -> None:
        """Plan again, and move along the plan, but not further than ``way_m``.

        Raises:
            NoWay: there is no plan.
            ArmStopped: the arm did not move as commanded.
        """
        ...

    def resting(self, arm: str) -> Rest:
        """Return a context in which the other arms need not wait for this arm's request."""
        ...


@dataclass
class Rest:
    """A period in which an arm requests no motion."""

    arm: str
    awake: set[str] = field(default_factory=set)
    changed: object = None

    def __enter__(self) -> None:
        self.awake.discard(self.arm)
        if self.changed is not None:
            self.changed()  # type: ignore[operator]

    def __exit__(self, *_: object) -> None:
        self.awake.add(self.arm)


class Beside:
    """Plans one arm at a time; what the other does meanwhile is a moving obstacle (V-C.1, decentralised)."""

    def __init__(self, cell: Cell, robot: Adjusted, problems: Problems, planner: Planner, settings: Settings):
        self._cell, self._robot, self._problems, self._settings = cell, robot, problems, settings
        self._planner = planner
        self._lock = trio.Lock()

    async def step(self, arm: str, asked: Asked, way_m: float) -> None:
        """Plan around what the others are doing, and move."""
        with self._cell.log.span(arm, "waiting"):
            await self._lock.acquire()
        try:
            budget_s = self._settings.plan_budget_s
            self._robot.keep(arm)
            plan = await self._cell.compute(
                arm, "planning", lambda: planned(self._problems, {arm: asked}, budget_s, self._planner), budget_s
            )
        finally:
            self._lock.release()  # nothing may come between this and the start of the motion, which waits later
        if plan is None or not plan.found:
            self._robot.learn(arm)
        if plan is None:
            return
        if not plan.found:
            self._cell.log.event("no_way", arm=arm, reason=plan.reason)
            raise NoWay(plan.reason, lasting=not names_another_arm(plan.reason, arm, self._cell.arms))
        motion = plan.trajectories[arm]
        await run(self._cell, self._robot, arm, motion, moment(self._cell, arm, motion, way_m))

    def resting(self, arm: str) -> Rest:
        """Return a context without effect, since no arm waits for another arm's request."""
        return Rest(arm)


@dataclass
class _Request:
    """An arm's request, and its result."""

    asked: Asked
    way_m: float
    plan: MotionPlan | None = None
    stop_s: float | None = None
    answered: trio.Event = field(default_factory=trio.Event)
    begun: bool = False
    nothing: bool = False


class Together:
    """Plans for all arms at once as soon as each has made a request (V-C.1, centralised), with one clock for all plans.

    An arm that waits for the token, or has nothing left to do, need not make one.
    """

    def __init__(
        self, cell: Cell, robot: Adjusted, problems: Problems, planner: Planner, settings: Settings, arms: set[str]
    ):
        self._cell, self._robot, self._problems, self._settings = cell, robot, problems, settings
        self._planner = planner
        self._awake = set(arms)
        self._requests: dict[str, _Request] = {}
        self._changed = trio.Event()
        self._alone = ""

    async def step(self, arm: str, asked: Asked, way_m: float) -> None:
        """Make a request, wait until the others have made theirs, and move as planned."""
        request = self._requests[arm] = _Request(asked, way_m)
        self._change()
        with self._cell.log.span(arm, "waiting"):
            while not request.begun and not self._awake <= self._requests.keys():
                await self._wait(request)
        if not request.begun and arm == min(self._requests):
            await self._answer()
        else:
            with self._cell.log.span(arm, "planning"):
                await request.answered.wait()
        if request.nothing:
            return
        plan = request.plan
        if plan is None or not plan.found:
            reason = plan.reason if plan else "nothing was planned"
            self._cell.log.event("no_way", arm=arm, reason=reason)
            raise NoWay(reason, lasting=plan is not None and not names_another_arm(reason, arm, self._cell.arms))
        await run(self._cell, self._robot, arm, plan.trajectories[arm], request.stop_s)

    def resting(self, arm: str) -> Rest:
        """Return a context in which the others plan without this arm, which stays where it is."""
        return Rest(arm, self._awake, self._change)

    async def _wait(self, request: _Request) -> None:
        async with trio.open_nursery() as nursery:

            async def wake(event: trio.Event) -> None:
                await event.wait()
                nursery.cancel_scope.cancel()

            nursery.start_soon(wake, self._changed)
            nursery.start_soon(wake, request.answered)

    def _change(self) -> None:
        self._changed.set()
        self._changed = trio.Event()

    async def _answer(self) -> None:
        """Plan for all arms with requests; if that fails, for each by itself around the others."""
        requests, self._requests = self._requests, {}
        for request in requests.values():
            request.begun = True
        self._change()
        first = min(requests)
        budget_s = self._settings.plan_budget_s

        def compute() -> dict[str, MotionPlan | None]:
            asked = {name: request.asked for name, request in requests.items()}
            plan = planned(self._problems, asked, budget_s, self._planner)
            if plan is not None and plan.found:
                return dict.fromkeys(asked, plan)
            found: dict[str, MotionPlan | None] = {}
            for name, a in sorted(asked.items(), key=lambda item: item[0] == self._alone):
                alone = found[name] = planned(self._problems, {name: a}, budget_s, self._planner)
                if alone is None or alone.found:  # one at a time, in turn, while the other one is at rest
                    self._alone = name
                    break
            return found

        plans = await self._cell.compute(first, "planning", compute, budget_s)
        for name, request in requests.items():
            request.plan = plans.get(name)
            request.nothing = name in plans and plans[name] is None
        self._stop_together(requests)
        for request in requests.values():
            request.answered.set()

    def _stop_together(self, requests: Mapping[str, _Request]) -> None:
        """Stop all jointly planned motions when the first arm has covered its distance."""
        moving = {name: r for name, r in requests.items() if r.plan is not None and r.plan.found}
        moments = [moment(self._cell, name, r.plan.trajectories[name], r.way_m) for name, r in moving.items() if r.plan]
        first = min((m for m in moments if m is not None), default=None)
        for request in moving.values():
            request.stop_s = first


def names_another_arm(reason: str, arm: str, arms: Iterable[str]) -> bool:
    """Return whether a planner's or guard's reason names a part of another arm, as in ``"right left finger"``."""
    return any(f"{name} {solid}" in reason for name in arms if name != arm for solid in SOLIDS)


def planned(problems: Problems, asked: Mapping[str, Asked], delay_s: float, planner: Planner) -> MotionPlan | None:
    """Return a plan; None if an arm is already at its goal."""
    try:
        plan = plan_motion(problems.of(asked, delay_s), planner)
    except TrocarError as error:
        return MotionPlan("convex", {}, float("nan"), 0.0, refusal=NoPlan(str(error)))
    return None if isinstance(plan.refusal, AlreadyThere) else plan


async def run(cell: Cell, robot: Adjusted, arm: str, motion: Trajectory, stop_s: float | None) -> None:
    """Run a motion, up to a time of its own if one is given.

    Raises:
        NoWay: the robot refuses.
        ArmStopped: it did not reach its end, and not because a step was over.
    """
    refusal: TrocarError | None = None
    execution = None
    with cell.log.span(arm, "motion"):
        async with trio.open_nursery() as nursery:
            if stop_s is not None:
                nursery.start_soon(_hold_in_time, cell, robot, arm)
            try:
                execution = (await robot.move({arm: motion}, stop_s))[arm]
            except TrocarError as error:
                refusal = error
            nursery.cancel_scope.cancel()
    if execution is None:
        cell.log.event("refused", arm=arm, reason=str(refusal))
        raise NoWay(str(refusal), lasting=TOO_NEAR not in str(refusal))
    if not execution.done and TOO_NEAR in execution.reason:  # the guard braked, because the estimates have changed
        raise NoWay(execution.reason)
    if not execution.done and not (execution.ended is MotionEnd.HELD and execution.reason == STEP_ENDED):
        raise ArmStopped(execution.reason)


async def _hold_in_time(cell: Cell, robot: Adjusted, arm: str) -> None:
    """Bring an arm to rest where its motion is to be stopped."""
    while not robot.setpoint(arm).moving or robot.to_stop_s(arm) > 0:
        await cell.clock.sleep(float(np.clip(robot.to_stop_s(arm), LEAST_WAIT_S, MOST_WAIT_S)))
    robot.hold(arm, reason=STEP_ENDED)


def moment(cell: Cell, arm: str, motion: Trajectory, way_m: float) -> float | None:
    """Return the time at which the tip has gone this far along a motion; None if the motion is shorter."""
    times, q = motion.sample(PATH_STEP_S)
    gone = np.cumsum(np.linalg.norm(np.diff(fk(cell.arms[arm], q).translation_m, axis=0), axis=-1))
    beyond = np.flatnonzero(gone > way_m)
    return None if not len(beyond) else float(times[beyond[0]])
