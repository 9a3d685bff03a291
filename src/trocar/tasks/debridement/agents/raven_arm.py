"""One Raven arm as used by the script: moves, grasps, lets go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from trocar.arms import ArmModel, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3
from trocar.motion import rest_to_rest
from trocar.robots.concurrency import together
from trocar.tasks.debridement.agents.eyes import Eyes
from trocar.tasks.debridement.agents.motion_asked import Asked, Problems
from trocar.tasks.debridement.agents.movers import WAIT_S, ArmStopped, Mover, NoWay, names_another_arm, run
from trocar.tasks.debridement.agents.places import Grasp, Places, raised, turn_of
from trocar.tasks.debridement.agents.settings import Settings

TRIES = 60
"""An arm that finds no path asks this many times, a quarter of a second apart, before it gives up."""
HIDDEN_TRIES = 8
"""It waits for this many looks (3 s) until its marks are visible. In that time the other arm passes, or it rests in
front of them; then the fragment is left to that arm, which would otherwise stay where it hides the marks."""
ENOUGH_PLACES = 6
"""This many of several reachable places are tried, since the path to one may leave a joint's range."""
RISE_SHARES = (1.0, 0.6, 0.3)
"""Shares of the height by which an arm is to rise, if it cannot go that high."""
FEW = 2
"""If no other arm is in the way, it asks again only this many times, since estimates change only a little."""
LOW_M = 0.020
"""A tip lower than this over the work surface rises before moving elsewhere: open fingers end 9 mm below it."""
WITHDRAWN_M = 0.006
"""An arm that is too close to something rises by this, or moves aside as far."""
ASKEW_RAD = 0.12
"""In the last millimetres, a gripper is not turned again if its rotation is within this of the plan."""
ARRIVED_HIGH_M = 6e-3
"""Accuracy of heights in the air, where fragments are below the fingers."""
NEARER_M, IN_VAIN = 1e-3, 8
"""An arm gives up its goal after this many steps in a row, each of which brings it no closer than by this."""
PRESSING_M, PRESSING = 2e-3, 2
"""Fingers that stay this high over a grasp after this many steps without progress stand on something, usually a
neighbour. Further corrections would press until it slips away."""
FIRST_SHARE = 0.5
"""The first descent is slower by this factor, because the change of kinematic errors with height is not known yet."""
CLOSING_STEPS = 25
"""A slow closing of the jaws consists of this many small steps."""


class RavenArm:
    """Actions of one arm.

    Args:
        problems: the laboratory and its obstacles.
        name: of the arm.
        eyes: the camera.
        mover: plans and moves.
        places: where things are.
        settings: of the method.
    """

    def __init__(self, problems: Problems, name: str, eyes: Eyes, mover: Mover, places: Places, settings: Settings):
        self.problems, self.cell, self.robot = problems, problems.cell, problems.robot
        self.name, self.eyes, self.mover, self.places, self.s = name, eyes, mover, places, settings
        self.side = places.side(problems.cell.T_world_base_registered[name])
        self._been_down = False

    @property
    def model(self) -> ArmModel:
        """Return the arm's model."""
        return self.cell.arms[self.name]

    async def go(
        self,
        T_world_goal: SE3,
        *,
        precise: bool = False,
        straight: bool = False,
        beside_wall: bool = False,
        speed_m_s: float | None = None,
        lift_m: float = 0.0,
    ) -> None:
        """Go somewhere in steps, planning again before each from the newest estimate (V-B).

        Args:
            T_world_goal: of the tip.
            precise: whether the camera has to confirm that it is there.
            straight: a short piece near a fragment.
            beside_wall: a place beside the receptacle's wall, below its edge.
            speed_m_s: of the tip; default: the method's.
            lift_m: the first step begins straight up by this height.

        Raises:
            NoWay: no plan was found for a long time.
            ArmStopped: the arm does not move as commanded.
        """
        speed = speed_m_s or self.s.tip_speed_m_s
        if precise:
            aside_m, high_m = self.s.reached_m, self.s.reached_high_m
        else:
            aside_m, high_m = self.s.arrived_m, min(self.s.arrived_m, ARRIVED_HIGH_M)
        visits, nearest_m, in_vain = 0, np.inf, 0
        while True:
            if lift_m > 0:
                await self._lift(Asked(T_world_goal, speed), lift_m)
                lift_m = 0.0
            else:
                if not straight:
                    await self._rise()  # an arm that was stopped because it was off its path may be low
                await self._step(Asked(T_world_goal, speed, straight, beside_wall))
            if precise:
                await self.settle()
                await self.eyes.glance(self.name)
            T_world_tip = self.robot.T_world_tip(self.name)
            off = np.abs(T_world_tip.translation_m - T_world_goal.translation_m)
            away_m = float(np.linalg.norm(off))
            visits += bool(away_m < self.s.close_m)
            in_vain = 0 if away_m < nearest_m - NEARER_M else in_vain + 1
            nearest_m = min(nearest_m, away_m)
            if (off < [aside_m, aside_m, high_m]).all() or visits > self.s.max_visits:
                return
            if in_vain == IN_VAIN:
                raise NoWay(f"arm {self.name!r} gets no nearer than {1e3 * nearest_m:.0f} mm to its goal", lasting=True)
            high = float(T_world_tip.translation_m[2] - T_world_goal.translation_m[2])
            if precise and straight and in_vain >= PRESSING and high > PRESSING_M:
                raise NoWay(f"the fingers of arm {self.name!r} stand on something {1e3 * high:.0f} mm over the grasp")
            if straight and (T_world_tip.rotation.inverse() @ T_world_goal.rotation).angle() < ASKEW_RAD:
                T_world_goal = SE3.from_parts(T_world_tip.rotation, T_world_goal.translation_m)

    async def _rise(self) -> None:
        """Go straight up first if the tip is so low that no plan could begin there."""
        T_world_tip = self.robot.T_world_tip(self.name)
        low = self.places.table_m + LOW_M - float(T_world_tip.translation_m[2])
        if low > 0:
            await self._step(Asked(raised(T_world_tip, low), self.s.descent_speed_m_s, straight=True))

    async def _lift(self, asked: Asked, by_m: float) -> None:
        """Go straight up, and on without a stop; if no such path is found, only go up."""
        up = raised(self.robot.T_world_tip(self.name), by_m)
        try:
            await self.mover.step(self.name, replace(asked, T_world_through=up), self.s.step_m)
        except NoWay:
            await self.rise(by_m)

    async def _step(self, asked: Asked) -> None:
        """Go one step, as soon as there is a path."""
        for number in range(TRIES):
            try:
                return await self.mover.step(self.name, asked, self.s.step_m)
            except NoWay as error:
                if error.begins_too_near:
                    await self._withdraw(str(error))
                    continue
                if number == TRIES - 1 or (error.lasting and number >= FEW):
                    raise
                with self.cell.log.span(self.name, "waiting"):
                    await self.cell.clock.sleep(WAIT_S)
                await self.eyes.glance(self.name)  # the same estimate gives the same path, or none

    async def _withdraw(self, reason: str) -> None:
        """Move a little away from what the arm is estimated to be too close to, after a change of the estimate.

        No plan can begin there; the robot's guard lets arms that are too close move apart, but no closer.
        """
        T_world_tip, aside = self.robot.T_world_tip(self.name), np.array([self.side, 0.0, 0.0])
        up = np.array([0.0, 0.0, 1.0])
        another = names_another_arm(reason, self.name, self.cell.arms)
        ways = (aside, aside + up, up, -aside) if another else (up, aside + up)
        for way in ways:
            goal = SE3.from_parts(T_world_tip.rotation, T_world_tip.translation_m + WITHDRAWN_M * way)
            try:
                goal_q = ik(
                    self.model,
                    self.cell.T_world_base_registered[self.name].inverse() @ goal,
                    reference=self.robot.setpoint(self.name).q,
                )
                motion = rest_to_rest(self.robot.setpoint(self.name).q, goal_q, self.model.motion_limits)
                return await run(self.cell, self.robot, self.name, motion, None)
            except (NoWay, OutOfReach):
                continue

    @property
    def turn_rad(self) -> float:
        """Return the rotation of the gripper about the vertical."""
        return turn_of(self.robot.T_world_tip(self.name))

    @property
    def height_m(self) -> float:
        """Return how high in the world the tip is."""
        return float(self.robot.T_world_tip(self.name).translation_m[2])

    def reachable(self, *poses: SE3) -> bool:
        """Return whether all of these poses of the tip are within the joints' ranges."""
        return all(self.robot.reaches(self.name, pose) for pose in poses)

    async def go_to_one(self, places: Sequence[SE3], lift_m: float = 0.0) -> None:
        """Go to the first of several places that is within reach, after rising straight up by this height.

        Raises:
            NoWay: none is; or as ``go``.
        """
        reason, tried = f"no place of {len(places)} is within reach of arm {self.name!r}", 0
        for place in places:
            if tried == ENOUGH_PLACES or not self.reachable(place):  # according to the present estimate
                continue
            try:
                tried += 1
                return await self.go(place, lift_m=lift_m)
            except NoWay as error:
                if not error.lasting:
                    raise
                reason, lift_m = str(error), 0.0
        raise NoWay(reason, lasting=True)

    def possible(self, grasps: Sequence[Grasp]) -> Grasp | None:
        """Return the first grasp that is within reach, with the path up after it."""
        for grasp in grasps:
            poses = grasp.T_world_above, grasp.T_world_grasp, raised(grasp.T_world_grasp, self.s.lift_m)
            clear = partial(self.problems.clear, self.name, grasp.T_world_above, grasp.open_rad)
            if self.reachable(*poses) and clear(beside_wall=True):
                return grasp
        return None

    async def settle(self) -> None:
        """Wait at rest until the arm is still."""
        with self.cell.log.span(self.name, "settling"):
            await self.cell.clock.sleep(self.s.settle_s)

    async def jaw(self, angle_rad: float, over_s: float = 0.0) -> None:
        """Drive the jaws, slowly if a time is given.

        Raises:
            ArmStopped: the robot stopped them.
        """
        with self.cell.log.span(self.name, "jaw"):
            jaw = self.model.jaw  # an object may have forced them beyond their range
            start = float(np.clip(self.robot.read(self.name).jaw_rad, jaw.lower, jaw.upper))
            steps = CLOSING_STEPS if over_s > 0 else 1
            for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
                execution = await self.cell.robot.jaw(self.name, start + share * (angle_rad - start))
                if not execution.done:
                    raise ArmStopped(execution.reason)
                await self.cell.clock.sleep(over_s / steps)

    async def take(self, grasp: Grasp) -> None:
        """Go above a fragment, look, go down, close the jaws."""
        above = grasp.T_world_above
        beside_wall = not self.problems.clear(self.name, above, grasp.open_rad, beside_wall=False)
        await together(
            partial(self.jaw, grasp.open_rad),
            partial(self.go, above, precise=self.s.confirms_above, beside_wall=beside_wall),
        )
        await self.seen_lately()
        speed = self.s.descent_speed_m_s * (1.0 if self._been_down else FIRST_SHARE)
        await self.go(grasp.T_world_grasp, precise=True, straight=True, speed_m_s=speed)
        self._been_down = True
        self.cell.log.event("closing", arm=self.name)
        await self.jaw(0.0, self.s.close_s)

    async def stroke(self, height_m: float, open_rad: float) -> None:
        """Go straight down to a height in the world with this jaw opening, close the jaws there, and come up again."""
        T_world_tip = self.robot.T_world_tip(self.name)
        by_m = float(T_world_tip.translation_m[2]) - height_m
        await self.jaw(open_rad)
        await self.go(raised(T_world_tip, -by_m), straight=True)
        await self.jaw(0.0)
        await self.rise(by_m)

    async def rise(self, by_m: float) -> None:
        """Go straight up, or as far as that is possible."""
        for share in RISE_SHARES:
            up = raised(self.robot.T_world_tip(self.name), share * by_m)
            try:
                return await self.go(up, straight=True)
            except NoWay as error:
                if not error.lasting:
                    raise
        self.cell.log.event("not_lifted", arm=self.name)

    async def seen_lately(self) -> None:
        """Wait until the camera has recently seen the gripper.

        Raises:
            NoWay: it has not seen it for a long time.
        """
        for _ in range(HIDDEN_TRIES):
            if self.robot.age_s(self.name) <= self.s.fresh_s:
                return
            await self.eyes.glance(self.name)
            with self.cell.log.span(self.name, "waiting"):
                await self.cell.clock.sleep(WAIT_S)
        raise NoWay("the marks on the gripper are hidden")
