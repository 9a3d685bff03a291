"""The arms' motions: planned around what the other arm does, or for both arms at once, and run step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trio

from trocar.arms import fk, ik
from trocar.cell import Cell
from trocar.errors import AlreadyThere, ArmStopped, MotionRefused, TooNear
from trocar.geometry import SE3
from trocar.motion import ArmMotion, Facing, HalfSpace, MotionPlan, MotionProblem, Obstacle, open_box, plan_motion
from trocar.motion.bodies import MovingArm
from trocar.motion.clearance import swept_clearance
from trocar.motion.planners import Planner
from trocar.robots.coordinator import Coordinator
from trocar.tasks.debridement.agents.adjusted import Adjusted, StepEnded
from trocar.tasks.debridement.agents.observer import CAMERA
from trocar.tasks.debridement.agents.settings import Settings
from trocar.tasks.debridement.goals import Workspace
from trocar.trajectory import Trajectory

JAW_AXIS = (0.0, 1.0, 0.0)  # axis in the tip's frame along which the discs of the marks face
MAX_FACING_RAD = np.radians(75.0)  # beyond this angle the marks are seen too much from the side
SUNK_M = 2.5e-3
"""For planning, the work surface is lowered by this and the margin: a finger's capsule is that much thicker than its
end, and arms come close to the surface to take fragments."""
PATH_STEP_S = 0.05
LEAST_WAIT_S, MOST_WAIT_S = 0.01, 0.1  # limits of the interval between checks whether an arm is to be stopped


class NotItsTurn(MotionRefused):
    """No plan for both arms was found; the other one moves first."""


class NoMotion(MotionRefused):
    """An arm cannot go on: no plan was found, or the robot refused it, or stopped the arm before a collision."""

    def __init__(self, arm: str, cause: MotionRefused, *, lasting: bool = False):
        self.cause = cause
        self.lasting = lasting  # only other estimates would help, because no other arm is in the way
        super().__init__(str(cause), arm=arm)

    @property
    def begins_too_near(self) -> bool:
        """Return whether the arm is estimated to be too close to something already."""
        return isinstance(self.cause, TooNear) and self.cause.at_start


def near_another_arm(arm: str, refusal: MotionRefused) -> bool:
    """Return whether a motion was refused because it comes too close to another arm."""
    return isinstance(refusal, TooNear) and any(name != arm for name in refusal.arms)


@dataclass(frozen=True)
class TipGoal:
    """One arm's next motion."""

    T_world_tip: SE3  # where its tip is to go
    speed_m_s: float  # of the tip at most
    straight: bool = False  # a short piece down to a fragment or up from it: the fingers may be near the work surface
    beside_wall: bool = False  # a place so close to the receptacle that the true height of its walls has to be used
    T_world_through: tuple[SE3, ...] = ()  # poses of the tip to pass on the way without a stop


class _Answer(NamedTuple):
    """What an arm is to do: run a motion, up to ``stop_s`` of its time; nothing; or stay, because of a refusal."""

    motion: Trajectory | None = None
    stop_s: float | None = None
    refusal: MotionRefused | None = None


@dataclass(frozen=True, eq=False)
class MotionProblems:
    """Makes motion problems from goals, starting from the estimated state of everything."""

    cell: Cell  # the laboratory
    robot: Adjusted  # the same robot, which estimates where the arms are
    workspace: Workspace  # what is known of the work surface
    settings: Settings  # of the method

    def obstacles(self, beside_wall: bool) -> dict[str, Obstacle]:
        """Return work surface and receptacle as obstacles, for travelling or for going down beside a wall."""
        T_world_table, box = self.cell.T_world_fixture["table"], self.workspace.receptacle
        normal = T_world_table.rotation.matrix[:, 2]
        table = HalfSpace(T_world_table.translation_m - (SUNK_M + self.settings.margin_m) * normal, normal)
        height_m = box.height_m + (0.0 if beside_wall else self.settings.hanging_m)
        T_world_receptacle = self.cell.T_world_fixture["receptacle"]
        walls = open_box("receptacle", T_world_receptacle, inside_m=box.size_m, height_m=height_m, radius_m=box.wall_m)
        return {"table": table, **walls}

    def of(self, goals: Mapping[str, TipGoal], delay_s: float) -> MotionProblem:
        """Return the problem of these arms beside the others, for motions that start ``delay_s`` from now."""
        others = {name: self._other(name, delay_s) for name in self.cell.arms if name not in goals}
        free = all(not goal.straight for goal in goals.values())
        return MotionProblem(
            {name: self._motion(name, goal) for name, goal in goals.items()},
            others=others,
            obstacles=self.obstacles(any(goal.beside_wall for goal in goals.values())) if free else {},
            min_distance_m=self.settings.margin_m,
        )

    def clear(self, name: str, T_world_tip: SE3, jaw_rad: float, beside_wall: bool) -> bool:
        """Return whether an arm at rest there, with this jaw opening, is clear of work surface and receptacle."""
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        q = ik(model, T_world_base.inverse() @ T_world_tip, reference=self.robot.setpoint(name).q)
        there = MovingArm.resting(model, q, T_world_base, jaw_rad)
        found = swept_clearance({name: there}, obstacles=self.obstacles(beside_wall), enough_m=self.settings.margin_m)
        return found.distance_m >= self.settings.margin_m

    def _motion(self, name: str, goal: TipGoal) -> ArmMotion:
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        q, limits = self.robot.setpoint(name).q, self.cell.limits[name].scaled(self.settings.limits_share)
        T_world_goals = SE3.unchecked(np.stack([T.matrix for T in (*goal.T_world_through, goal.T_world_tip)]))
        T_world_camera = self.cell.T_world_camera_registered[CAMERA]
        facing = Facing(np.array(JAW_AXIS), T_world_camera.translation_m, float(MAX_FACING_RAD))
        within = all(
            facing.angle_rad(T) < MAX_FACING_RAD for T in (goal.T_world_tip, T_world_base @ fk(model, q))
        )  # an arm whose marks cannot be seen now has to come back first
        return ArmMotion(
            model, q[None], limits, T_world_base=T_world_base,
            T_base_goals=T_world_base.inverse() @ T_world_goals, jaw_rad=self.robot.read(name).jaw_rad,
            max_tip_m_s=goal.speed_m_s, facing=facing if within else None,
        )  # fmt: skip

    def _other(self, name: str, delay_s: float) -> MovingArm:
        """Return what another arm is doing, shifted to where it is commanded now."""
        model, T_world_base = self.cell.arms[name], self.cell.T_world_base_registered[name]
        jaw_rad, course, setpoint = self.robot.read(name).jaw_rad, self.robot.course(name), self.robot.setpoint(name)
        if course is None:
            return MovingArm.resting(model, setpoint.q, T_world_base, jaw_rad)
        trajectory, began_s = course
        coefficients = trajectory.coefficients.copy()
        coefficients[-1] += setpoint.q - trajectory(setpoint.path_s)
        start_s = began_s - self.cell.clock.now_s() - delay_s
        return MovingArm(model, Trajectory(trajectory.times_s, coefficients), T_world_base, start_s, jaw_rad)


class MotionRunner:
    """Moves arms step by step along their paths, each step planned from the newest estimate.

    One arm is planned at a time, and what the other does meanwhile is a moving obstacle (V-C.1, decentralised); or, if
    the settings are ``centralised``, both at once as soon as each has asked, with one clock for all plans.
    """

    def __init__(self, problems: MotionProblems, coordinator: Coordinator, planner: Planner):
        self.problems, self._cell, self._robot = problems, problems.cell, problems.robot
        self._settings = problems.settings
        self._coordinator, self._planner = coordinator, planner
        self._planning = trio.Lock()
        self._moved_alone = ""

    async def step(self, arm: str, goal: TipGoal) -> None:
        """Plan again, and move along the plan, but not further than a step.

        Raises:
            NoMotion: there is no plan, or the robot refuses it.
            ArmStopped: the arm did not move as commanded.
        """
        if self._settings.centralised:
            answer: _Answer = await self._coordinator.decide_together(arm, goal, self._plan_together)
        else:
            answer = await self._plan_beside(arm, goal)
        if answer.refusal is not None:
            self._cell.log.event("no_way", arm=arm, reason=str(answer.refusal))
            lasting = not (isinstance(answer.refusal, NotItsTurn) or near_another_arm(arm, answer.refusal))
            raise NoMotion(arm, answer.refusal, lasting=lasting)
        if answer.motion is not None:
            await self.run(arm, answer.motion, answer.stop_s)

    async def run(self, arm: str, motion: Trajectory, stop_s: float | None = None) -> None:
        """Run a motion, up to ``stop_s`` of its time if given.

        Raises:
            NoMotion: the robot refuses, or its guard has stopped the arm because estimates have changed.
            ArmStopped: the motion ended early, and not because a step was over.
        """
        refusal = result = None
        with self._cell.log.span(arm, "motion"):
            async with trio.open_nursery() as nursery:
                if stop_s is not None:
                    nursery.start_soon(self._hold_in_time, arm)
                try:
                    result = (await self._robot.move({arm: motion}, stop_s))[arm]
                except MotionRefused as error:
                    refusal = error
                nursery.cancel_scope.cancel()
        if refusal is not None:
            self._cell.log.event("refused", arm=arm, reason=str(refusal))
            raise NoMotion(arm, refusal, lasting=not isinstance(refusal, TooNear))
        if result is None or result.done or isinstance(result.cause, StepEnded):
            return
        if isinstance(result.cause, TooNear):
            raise NoMotion(arm, result.cause)
        raise ArmStopped(arm, result.reason)

    async def _hold_in_time(self, arm: str) -> None:
        """Bring an arm to rest where its motion is to be stopped."""
        while not self._robot.setpoint(arm).moving or self._robot.to_stop_s(arm) > 0:
            await self._cell.clock.sleep(float(np.clip(self._robot.to_stop_s(arm), LEAST_WAIT_S, MOST_WAIT_S)))
        self._robot.hold(arm, reason=StepEnded(arm))

    async def _plan_beside(self, arm: str, goal: TipGoal) -> _Answer:
        """Plan around what the others are doing, while no other arm plans."""
        with self._cell.log.span(arm, "waiting"):
            await self._planning.acquire()
        try:
            budget_s = self._settings.plan_budget_s
            self._robot.keep(arm)
            plan = await self._cell.compute(arm, "planning", lambda: self._plan({arm: goal}), budget_s)
        finally:
            self._planning.release()  # no other arm plans before the motion starts: nothing waits until then
        if not plan.found:
            self._robot.learn(arm)
            return _unmoved(plan)
        motion = plan.trajectories[arm]
        return _Answer(motion, self._time_to_stop(arm, motion))

    async def _plan_together(self, goals: Mapping[str, TipGoal]) -> dict[str, _Answer]:
        """Plan for all arms that have asked; if that fails, for one by itself, while the other one is at rest.

        All jointly planned motions stop when the first arm has covered its distance.
        """

        def compute() -> dict[str, MotionPlan]:
            plan = self._plan(goals)
            if plan.found:
                return dict.fromkeys(goals, plan)
            found: dict[str, MotionPlan] = {}
            for name in sorted(goals, key=lambda name: name == self._moved_alone):  # arms take turns
                found[name] = self._plan({name: goals[name]})
                if found[name].found or isinstance(found[name].refusal, AlreadyThere):
                    self._moved_alone = name
                    break
            return found

        plans = await self._cell.compute(min(goals), "planning", compute, self._settings.plan_budget_s)
        motions = {name: plan.trajectories[name] for name, plan in plans.items() if plan.found}
        times = [self._time_to_stop(name, motion) for name, motion in motions.items()]
        stop_s = min((time_s for time_s in times if time_s is not None), default=None)
        unmoved = {name: _unmoved(plan) for name, plan in plans.items() if not plan.found}
        moved = {name: _Answer(motion, stop_s) for name, motion in motions.items()}
        return dict.fromkeys(goals, _Answer(refusal=NotItsTurn("nothing was planned"))) | unmoved | moved

    def _plan(self, goals: Mapping[str, TipGoal]) -> MotionPlan:
        return plan_motion(self.problems.of(goals, self._settings.plan_budget_s), self._planner)

    def _time_to_stop(self, arm: str, motion: Trajectory) -> float | None:
        """Return the time at which the tip has gone a whole step and plans again; None if the motion is shorter."""
        times, q = motion.sample(PATH_STEP_S)
        gone = np.cumsum(np.linalg.norm(np.diff(fk(self._cell.arms[arm], q).translation_m, axis=0), axis=-1))
        beyond = np.flatnonzero(gone > self._settings.step_m)
        return None if not len(beyond) else float(times[beyond[0]])


def _unmoved(plan: MotionPlan) -> _Answer:
    """Return the answer if nothing was planned: the arm is there already, or cannot go there."""
    return _Answer(refusal=None if isinstance(plan.refusal, AlreadyThere) else plan.refusal)
