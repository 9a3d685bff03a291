"""One Raven arm as used by the script: moves, grasps, lets go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice, product

import numpy as np

from trocar.arms import ik
from trocar.cell import MotionEnd
from trocar.errors import ArmStopped, NoPlan, OutOfReach
from trocar.geometry import SE3, SO3
from trocar.motion import rest_to_rest
from trocar.robots.concurrency import together
from trocar.tasks.debridement.agents.adjusted import StepEnded
from trocar.tasks.debridement.agents.motions import MotionRunner, NoMotion, TipGoal, near_another_arm
from trocar.tasks.debridement.agents.observer import Observation, StereoObserver
from trocar.tasks.debridement.agents.places import Grasp, Places, raised
from trocar.tasks.debridement.agents.settings import Settings

TRIES, WAIT_S = 60, 0.25
"""An arm that finds no path asks this many times, this long apart, before it gives up; the other one moves on
meanwhile."""
HIDDEN_TRIES = 8
"""An arm with hidden marks waits for this many looks (3 s). In that time the other arm passes; or else it rests before
the marks, and the fragment is left to it, because it would stay there otherwise."""
ENOUGH_PLACES = 6  # this many of several reachable places are tried, since the path to one may leave a joint's range
RISE_SHARES = (1.0, 0.6, 0.3)  # shares of the height by which an arm is to rise, if it cannot go that high
FEW = 2  # if no other arm is in the way, it asks again only this many times, since estimates change only a little
LOW_M = 0.020
"""A tip lower than this over the work surface rises before moving elsewhere: open fingers end 9 mm below it."""
WITHDRAWN_M = 0.006  # an arm that is too close to something rises by this, or moves aside as far
ASKEW_RAD = 0.12  # in the last millimetres, a gripper is not turned again if its rotation is within this of the plan
ARRIVED_HIGH_M = 6e-3  # accuracy of heights in the air, where fragments are below the fingers
FURTHER_M = 1e-3  # limit on each axis of how much further than the grasp a correction aims, since play takes up a part
NEARER_M, IN_VAIN = 1e-3, 8
"""An arm gives up its goal after ``IN_VAIN`` steps in a row that each bring it closer by less than ``NEARER_M``."""
PRESSING_M, PRESSING = 2e-3, 2
"""Fingers that stay this high over a grasp after this many steps without progress stand on something, usually a
neighbouring fragment, which would slip away under the pressure of further corrections."""
FIRST_SHARE = 0.5
"""The first descent is slower by this factor, because the change of kinematic errors with height is not known yet."""
CLOSING_STEPS = 25  # a slow closing of the jaws consists of this many small steps

SEARCH = tuple((0.01 * np.array(place_cm), np.radians(lean_deg)) for place_cm, lean_deg in (
    ((0, 0, 0), 0), ((0, 0, -2), 0), ((-2, 0, -2), 0), ((-2, 0, -2), 25), ((-4, 0, -2), 0), ((-2, 2, -4), 0),
    ((-2, -3, -2), 25), ((0, -3, 0), 0), ((-4, 3, 1), 0), ((-2, 0, 3), 25), ((2, 0, 0), 0),
))  # fmt: skip
"""Displacements that an unseen arm tries, one after the other, and how far its marks are turned up towards the camera:
down and towards the middle first (x), then turned, across and up. Its true pose is unknown; if it were low, it would be
in the picture, and its rotation may be wrong by 25 deg."""
SHAKES, SHAKEN_RAD = 2, 2.0
"""Jaws to which a fragment clings open wider, then close and open again, so many times in all. Jaws that are less open
hold a charged fragment between both fingers; opened this far, mostly only one finger keeps it, and closing changes how
it hangs there."""
SHAKEN_M = 0.008
"""The first time, the jaws also rise by this, so that a fragment that merely lay behind them stays behind."""
STROKES = tuple(product((1.2, 2.0, 0.7), (0.014, 0.013, 0.012)))
"""Jaw openings (rad) and heights of the tip over the work surface (m), tried in turn if a fragment still clings: the
tip goes down there and the jaws close. Their ends, then 10 mm below the tip, rub the fragment on the receptacle's
floor, or grasp it."""
WAYS = SHAKES + len(STROKES)


class RavenArm:
    """Actions of one arm: it looks with an observer, plans and moves with a runner, and knows the places."""

    def __init__(self, name: str, observer: StereoObserver, runner: MotionRunner, places: Places, settings: Settings):
        self.name, self.observer, self.runner, self.places, self.s = name, observer, runner, places, settings
        self.problems = runner.problems
        self.cell, self.robot = self.problems.cell, self.problems.robot
        self.model, self.side = self.cell.arms[name], places.side(self.cell.T_world_base_registered[name])
        self._been_down = False

    async def go(
        self,
        T_world_goal: SE3,
        *,
        precise: bool = False,
        straight: bool = False,
        beside_wall: bool = False,
        speed_m_s: float | None = None,
        lift_m: float = 0.0,
        looks_first: bool = False,
        enough: Callable[[], bool] = lambda: False,
    ) -> None:
        """Bring the tip somewhere in steps, planning again before each from the newest estimate (V-B).

        Args:
            T_world_goal: pose of the tip.
            precise: whether the camera has to confirm that the tip is there.
            straight: as in ``TipGoal``.
            beside_wall: as in ``TipGoal``.
            speed_m_s: of the tip; default: that of the settings.
            lift_m: the first step begins straight up by this height.
            looks_first: before the first step, because the arm may be there already.
            enough: returns whether no further step is needed, wherever the arm is.

        Raises:
            NoMotion: no plan was found for a long time, or steps bring the tip no nearer.
            ArmStopped: the arm does not move as commanded.
        """
        speed = speed_m_s or self.s.tip_speed_m_s
        s, air_m = self.s, min(self.s.arrived_m, ARRIVED_HIGH_M)
        aside_m, high_m, low_m = (
            (s.reached_m, s.reached_high_m, s.reached_low_m) if precise else (s.arrived_m, air_m, air_m)
        )
        visits, nearest_m, in_vain, T_world_aim = 0, np.inf, 0, T_world_goal
        while True:
            if looks_first:
                looks_first = False
            elif lift_m > 0:
                await self._lift(TipGoal(T_world_goal, speed), lift_m)
                lift_m = 0.0
            else:
                if not straight:
                    await self._rise()  # an arm that was stopped because it was off its path may be low
                await self._step(TipGoal(T_world_aim, speed, straight, beside_wall))
            if precise:
                await self.settle()
                await self.observer.track(self.name)
            T_world_tip = self.robot.T_world_tip(self.name)
            off = T_world_tip.translation_m - T_world_goal.translation_m
            away_m = float(np.linalg.norm(off))
            visits += bool(away_m < self.s.close_m)
            in_vain = 0 if away_m < nearest_m - NEARER_M else in_vain + 1
            nearest_m = min(nearest_m, away_m)
            there = (np.abs(off[:2]) < aside_m).all() and -low_m < off[2] < high_m
            if there or visits > self.s.max_visits or enough():
                return
            if in_vain == IN_VAIN:
                reason = f"arm {self.name!r} gets no nearer than {1e3 * nearest_m:.0f} mm to its goal"
                raise NoMotion(self.name, NoPlan(reason), lasting=True)
            if precise and straight and in_vain >= PRESSING and off[2] > PRESSING_M:
                reason = f"the fingers of arm {self.name!r} stand on something {1e3 * off[2]:.0f} mm over the grasp"
                raise NoMotion(self.name, NoPlan(reason))
            if straight and (T_world_tip.rotation.inverse() @ T_world_goal.rotation).angle() < ASKEW_RAD:
                T_world_goal = SE3.from_parts(T_world_tip.rotation, T_world_goal.translation_m)
            further = np.clip(-s.further_share * off, -FURTHER_M, FURTHER_M) if precise else np.zeros(3)
            T_world_aim = SE3.from_parts(T_world_goal.rotation, T_world_goal.translation_m + further)

    async def _rise(self) -> None:
        """Go straight up first if the tip is so low that no plan could begin there."""
        T_world_tip = self.robot.T_world_tip(self.name)
        low = self.places.table_m + LOW_M - float(T_world_tip.translation_m[2])
        if low > 0:
            await self._step(TipGoal(raised(T_world_tip, low), self.s.descent_speed_m_s, straight=True))

    async def _lift(self, goal: TipGoal, by_m: float) -> None:
        """Go straight up, and on without a stop; if no such path is found, only go up, over walls that are too near."""
        up = raised(self.robot.T_world_tip(self.name), by_m)
        try:
            await self.runner.step(self.name, replace(goal, T_world_through=(up,)))
        except NoMotion as error:
            over_m = self.places.table_m + self.s.drop_high_m - self.height_m
            await self.rise(max(by_m, over_m) if error.begins_too_near else by_m)

    async def _step(self, goal: TipGoal) -> None:
        """Go one step, as soon as there is a path."""
        for number in range(TRIES):
            try:
                return await self.runner.step(self.name, goal)
            except NoMotion as error:
                if error.begins_too_near:
                    await self._withdraw(near_another_arm(self.name, error.cause))
                    continue
                if number == TRIES - 1 or (error.lasting and number >= FEW):
                    raise
                with self.cell.log.span(self.name, "waiting"):
                    await self.cell.clock.sleep(WAIT_S)
                await self.observer.track(self.name)  # the same estimate gives the same path, or none

    async def _withdraw(self, from_arm: bool) -> None:
        """Move a little away from something that is too close after a change of the estimate.

        No plan can begin there, but the robot's guard lets arms that are too close move apart.
        """
        T_world_tip = self.robot.T_world_tip(self.name)
        T_base_world = self.cell.T_world_base_registered[self.name].inverse()
        aside, up = np.array([self.side, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        ways = (aside, aside + up, up, -aside) if from_arm else (up, aside + up)
        for way in ways:
            goal = SE3.from_parts(T_world_tip.rotation, T_world_tip.translation_m + WITHDRAWN_M * way)
            q = self.robot.setpoint(self.name).q
            try:
                goal_q = ik(self.model, T_base_world @ goal, reference=q)
                return await self.runner.run(self.name, rest_to_rest(q, goal_q, self.cell.limits[self.name]))
            except (NoMotion, OutOfReach):
                continue

    @property
    def turn_rad(self) -> float:
        """Return the rotation of the gripper, which points downwards, about the vertical."""
        across = self.robot.T_world_tip(self.name).rotation.matrix[:, 0]
        return float(np.arctan2(across[1], across[0]))

    @property
    def height_m(self) -> float:
        """Return the height of the tip in the world."""
        return float(self.robot.T_world_tip(self.name).translation_m[2])

    async def go_to_one(
        self, places: Sequence[SE3], lift_m: float = 0.0, enough: Callable[[], bool] = lambda: False
    ) -> None:
        """Go to the first of several places that is within reach, after rising straight up by this height.

        ``enough``: as in ``go``.

        Raises:
            NoMotion: no place is within reach; or as in ``go``.
        """
        none = NoPlan(f"no place of {len(places)} is within reach of arm {self.name!r}")
        refusal = NoMotion(self.name, none, lasting=True)
        # checked lazily, since the estimate may change before a place is tried
        reachable = (place for place in places if self.robot.reaches(self.name, place))
        for place in islice(reachable, ENOUGH_PLACES):
            try:
                return await self.go(place, lift_m=lift_m, enough=enough)
            except NoMotion as error:
                if not error.lasting:
                    raise
                refusal, lift_m = error, 0.0
        raise refusal

    def possible(self, grasps: Sequence[Grasp]) -> Grasp | None:
        """Return the first grasp that is within reach with its lift, and clear of surface and walls, or None."""
        for grasp in grasps:
            poses = grasp.T_world_above, grasp.T_world_grasp, raised(grasp.T_world_grasp, self.s.lift_m)
            reachable = all(self.robot.reaches(self.name, pose) for pose in poses)
            if reachable and self.problems.clear(self.name, grasp.T_world_above, grasp.open_rad, beside_wall=True):
                return grasp
        return None

    async def settle(self) -> None:
        """Wait at rest until the arm is still."""
        with self.cell.log.span(self.name, "settling"):
            await self.cell.clock.sleep(self.s.settle_s)

    async def jaw(self, angle_rad: float, over_s: float = 0.0) -> None:
        """Drive the jaws, slowly if a time is given.

        Jaws that stop because the arm is to plan again go on.

        Raises:
            ArmStopped: the robot stopped them.
        """
        with self.cell.log.span(self.name, "jaw"):
            jaw = self.model.jaw  # an object may have forced them beyond their range
            start = float(np.clip(self.robot.read(self.name).jaw_rad, jaw.lower, jaw.upper))
            steps = CLOSING_STEPS if over_s > 0 else 1
            for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
                execution = await self.cell.robot.jaw(self.name, start + share * (angle_rad - start))
                while isinstance(execution.cause, StepEnded):
                    execution = await self.cell.robot.jaw(self.name, start + share * (angle_rad - start))
                if execution.ended is MotionEnd.REPLACED:  # the arm opens them further for the next grasp
                    return
                if not execution.done:
                    raise ArmStopped(self.name, execution.reason)
                await self.cell.clock.sleep(over_s / steps)

    async def reach(self, grasp: Grasp) -> None:
        """Go to a fragment from above with open jaws, and look."""
        await together(partial(self.jaw, grasp.open_rad), partial(self._approach, grasp))
        await self.seen_lately()
        speed = self.s.descent_speed_m_s * (1.0 if self._been_down else FIRST_SHARE)
        down, low = grasp.T_world_grasp, self._is_low(grasp)
        await self.go(down, precise=True, straight=True, speed_m_s=speed, looks_first=low)
        self._been_down = True

    async def close(self) -> None:
        """Close the jaws on a fragment."""
        self.cell.log.event("closing", arm=self.name)
        await self.jaw(0.0, self.s.close_s)

    async def _approach(self, grasp: Grasp) -> None:
        """Go above a grasp, and on down to it without a stop if its place is known well enough."""
        above, down = grasp.T_world_above, grasp.T_world_grasp
        if self.s.flows and self._been_down and self.robot.age_s(self.name) <= self.s.fresh_s:
            # nothing hangs from open jaws, so they may pass low over walls
            goal = TipGoal(down, self.s.tip_speed_m_s, beside_wall=True, T_world_through=(above,))
            with suppress(NoMotion):  # there may be a path to the place above
                await self.runner.step(self.name, goal)
        if not self._is_low(grasp):
            beside_wall = not self.problems.clear(self.name, above, grasp.open_rad, beside_wall=False)
            await self.go(above, precise=self.s.confirms_above, beside_wall=beside_wall)

    def _is_low(self, grasp: Grasp) -> bool:
        """Return whether the tip is closer in height to a grasp than to the place above it."""
        heights = [float(T.translation_m[2]) for T in (grasp.T_world_above, grasp.T_world_grasp)]
        return self.height_m < 0.5 * sum(heights)

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
            except NoMotion as error:
                if not error.lasting:
                    raise
        self.cell.log.event("not_lifted", arm=self.name)

    async def seen_lately(self) -> None:
        """Wait until the camera has recently seen the gripper.

        Raises:
            NoMotion: it has not seen it for a long time.
        """
        for _ in range(HIDDEN_TRIES):
            if self.robot.age_s(self.name) <= self.s.fresh_s:
                return
            await self.observer.track(self.name)
            with self.cell.log.span(self.name, "waiting"):
                await self.cell.clock.sleep(WAIT_S)
        raise NoMotion(self.name, NoPlan("the marks on the gripper are hidden"))

    async def come_into_sight(self) -> Observation:
        """Get the gripper seen once, however wrong its kinematics are; return what that look showed.

        Raises:
            ArmStopped: it is not seen anywhere.
        """
        T_world_start = self.robot.T_world_tip(self.name)
        for off_m, lean_rad in SEARCH:
            R = SO3.axis("x", lean_rad) @ T_world_start.rotation
            goal = SE3.from_parts(R, T_world_start.translation_m + off_m * [self.side, 1, 1])
            with suppress(NoMotion):
                await self.runner.step(self.name, TipGoal(goal, self.s.tip_speed_m_s, straight=True))
                await self.settle()
                observed = await self.observer.observe(self.name)
                if self.robot.age_s(self.name) < np.inf:
                    return observed
        raise ArmStopped(self.name, f"no camera sees the gripper of arm {self.name!r}")

    async def shed(self, number: int) -> None:
        """Try way ``number`` of ``WAYS`` to get rid of a fragment that clings, shakes first; then open wide."""
        if number == 0:
            return await together(partial(self.jaw, SHAKEN_RAD), partial(self.rise, SHAKEN_M))
        if number < SHAKES:
            await self.jaw(0.0)
        else:
            open_rad, height_m = STROKES[number - SHAKES]
            await self.stroke(self.places.table_m + height_m, open_rad)
        await self.jaw(SHAKEN_RAD)
