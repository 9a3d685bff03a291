"""A whole simulated laboratory: world, arms, cameras, referee, on one clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import trio
from trio.testing import MockClock, wait_all_tasks_blocked

from trocar.cell import Cell, Result
from trocar.lab import SensorFlaws, Station
from trocar.lab.session import Session, draw_session
from trocar.lab.transmission import DriveTrain
from trocar.log import CellLog, timed
from trocar.perception.fiducials import Fixture
from trocar.robots import TICK_S, ArmGuard, Guarded, JointEstimator
from trocar.robots.concurrency import cause_of
from trocar.sim.cameras import CameraRenderer, SimCamera
from trocar.sim.pace import Pace, Script, Stepping, repeat_scheduling
from trocar.sim.record import ContactMonitor, Record, Recorder
from trocar.sim.robot import SimRobot
from trocar.sim.spec import Surface
from trocar.sim.watchdog import Watchdog
from trocar.sim.world import TaskWorld, World

REST_S = 0.5
"""The bodies settle for this long before the clock starts."""
GRACE_S, HURRY_S = 1.0, 10.0
"""Time after its budget that a script may use to clean up under a shield; then its clock jumps by this per tick."""

Listener = Callable[[Mapping[str, object]], None]
"""Called with each event of a log."""


class SimClock:
    """The virtual time of a cell: computations take the time declared for them."""

    def __init__(self, now_s: Callable[[], float]):
        self.now_s = now_s

    async def sleep(self, seconds: float) -> None:
        """Let this time pass on the cell's clock."""
        await trio.sleep(seconds)

    async def compute(self, function: Callable[[], Result], budget_s: float) -> tuple[Result, float]:
        """Return the result and the real time of the computation; the cell's clock counts the budget."""
        result, seconds = timed(function)
        await trio.sleep(budget_s)
        return result, seconds


class SimLaboratory:
    """One simulated laboratory with a task's objects in it, ready to run scripts; the arms are parked.

    Args:
        session: the session.
        task: a task's side of the world; None: nothing.
        rng: random numbers for cables and cameras.
        flaws: override those of the station's cameras.
        surface: parameters of contacts; None: the default.
        fixtures: spheres that instruments wear for a calibration, by arm.
        listener: called with each event of the log.

    Attributes:
        session: the session; simulator truth.
        world: the physics; simulator truth, for referee and tests.
        driver: the arms without their guard; for tests and faults.
        cell: the cell that scripts are given.
        log: the log of the scripts.
        cameras: cameras by name.
        recorder: records what happens, tick by tick.
        contacts: collects the collisions; simulator truth.
    """

    def __init__(
        self,
        session: Session,
        task: TaskWorld | None = None,
        rng: np.random.Generator | None = None,
        *,
        flaws: SensorFlaws | None = None,
        surface: Surface | None = None,
        fixtures: Mapping[str, Fixture] | None = None,
        listener: Listener | None = None,
    ):
        station, self.session, self.task = session.station, session, task or TaskWorld()
        self._ticks = 0
        cable_rng, camera_rng = (rng or np.random.default_rng(0)).spawn(2)
        self.world = World(session.models, session.T_world_base, self.task, surface=surface, fixtures=fixtures)
        self.driver = SimRobot(self.world, self.now_s)
        for name, arm in station.arms.items():
            train = DriveTrain(session.transmissions[name], arm.park_q(), cable_rng)
            self.driver.attach_train(name, arm, train, session.jaws[name])
        self.task.start(self.world)
        self.world.settle(REST_S)
        self.log = CellLog(self.now_s, listener=listener)
        self.cameras: dict[str, SimCamera] = {}
        for name, camera in station.cameras.items():
            renderer = CameraRenderer(self.world.model, camera, session.T_world_camera[name], flaws)
            self.cameras[name] = SimCamera(self.world, renderer, camera.exposure_s, camera_rng)
        guards = {
            name: ArmGuard(arm.model, arm.limits, session.T_world_base_registered[name], arm.workspace_m)
            for name, arm in station.arms.items()
        }
        self._guard = Guarded(self.driver, guards, min_distance_m=station.min_distance_m, note=self.log.event)
        self.contacts = ContactMonitor(self.world)
        self.recorder = Recorder(self.world, self._guard, self.driver.jaw_command_rad)
        self.cell = Cell(
            robot=self._guard,
            cameras=self.cameras,
            arms=station.models,
            limits=station.limits,
            T_world_base_registered=session.T_world_base_registered,
            T_world_camera_registered=session.T_world_camera_registered,
            T_world_fixture=station.T_world_fixture,
            clock=SimClock(self.now_s),
            log=self.log,
            assistants=self.task.assistants(),
        )
        self._observe()
        self._nursery: trio.Nursery | None = None
        self._watchdog: Watchdog | None = None
        self._turning = False

    def now_s(self) -> float:
        """Return the time of the cell's clock."""
        return self._ticks * TICK_S

    def wrap_robot(self, wrap: Callable[[Cell], Any]) -> Cell:
        """Add a wrapper to the robot, made by ``wrap`` from the cell; return the cell with the wrapped robot."""
        robot = self.recorder.desired_of = wrap(self.cell)
        self.cell = replace(self.cell, robot=robot)
        if isinstance(robot, JointEstimator):
            self._guard.estimator = robot
        return self.cell

    def tick(self) -> None:
        """Advance everything by one period of the controller, 10 ms."""
        self.driver.tick(self.now_s())
        self._ticks += 1
        self.world.data.time = self.now_s()  # a sum of 1 ms steps has rounding errors
        self._guard.check()
        self._observe()

    def _observe(self) -> None:
        for observer in (self.recorder, self.task, self.contacts):
            observer.observe(self.now_s())

    def record(self) -> Record:
        """Return what has happened so far; simulator truth."""
        return self.recorder.record(self.contacts.collisions())

    def truth(self) -> Any:
        """Return the task's truth so far, only for the task's score."""
        return self.task.truth(self.record())

    def run(self, script: Script, budget_s: float, pace: Pace | None = None) -> bool:
        """Run a script on the cell's clock; return whether it ended within its budget.

        However it ends, an error or Ctrl-C included, every arm comes to rest within its limits before this returns.

        Args:
            script: called with the cell.
            budget_s: budget on the cell's clock.
            pace: how fast the clock runs; None: as fast as it can.

        Raises:
            BaseException: whatever the script raises, without the exception groups of nurseries; an interruption takes
                precedence.
        """
        clock, ended = MockClock(), False
        repeat_scheduling()
        with Watchdog(self.now_s, self._in_script) as self._watchdog:
            try:
                ended = trio.run(self._run, script, budget_s, pace, clock, clock=clock)
            except BaseException as error:
                if not self._watchdog.asked:
                    raise cause_of(error) from None
        if self._watchdog.asked:
            where = self._watchdog.where
            raise KeyboardInterrupt(*([f"stopped in {where}, which let no time pass"] if where else []))
        return ended

    def _in_script(self) -> bool:
        """Return whether a script runs now, rather than the physics, a camera or the braking of the arms."""
        rendering = any(camera.rendering for camera in self.cameras.values())
        return self._nursery is not None and not self._turning and not rendering

    def stepping(self, script: Script | None = None, budget_s: float = float("inf")) -> Stepping:
        """Return a context manager that steps the cell from outside."""
        return Stepping(self, script, budget_s)

    def start_soon(self, script: Script) -> None:
        """Start another script beside the one that runs (RuntimeError: none runs)."""
        if self._nursery is None:
            raise RuntimeError("a script can be started only while the cell runs")
        self._nursery.start_soon(script, self.cell)

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C was pressed; the cell then ends at its next tick."""
        return self._watchdog is not None and self._watchdog.asked

    def end(self) -> None:
        """Cancel all running scripts; the arms come to rest."""
        if self._nursery is not None:
            self._nursery.cancel_scope.cancel()

    async def _run(self, script: Script, budget_s: float, pace: Pace | None, clock: MockClock) -> bool:
        ended = False
        async with trio.open_nursery() as outer:
            budget = trio.CancelScope(deadline=trio.current_time() + budget_s)
            outer.start_soon(self._turn, pace, clock, budget.deadline + GRACE_S)
            try:
                with budget:
                    async with trio.open_nursery() as scripts:
                        self._nursery = scripts
                        await script(self.cell)
                        ended = not budget.cancel_called
                        scripts.cancel_scope.cancel()
            finally:
                # the physics continues until all arms have come to rest
                self._nursery = None
                with trio.CancelScope(shield=True):
                    self.cell.robot.hold(reason="the script has ended")
                    await self.cell.robot.rest()
                outer.cancel_scope.cancel()
        return ended

    async def _turn(self, pace: Pace | None, clock: MockClock, latest_s: float) -> None:
        """Run the clock: let every script run until it waits, then advance 10 ms; forever."""
        try:
            while True:
                await wait_all_tasks_blocked()
                self._turning = True
                if pace is not None:
                    await pace.wait(self.now_s())
                if self._watchdog is not None and self._watchdog.asked and self._nursery is not None:
                    self._nursery.cancel_scope.cancel()
                    latest_s = min(latest_s, clock.current_time() + GRACE_S)
                self.tick()
                self._turning = False
                shielded = self._nursery is not None and clock.current_time() > latest_s
                clock.jump(HURRY_S if shielded else TICK_S)
        except Exception as error:
            # without this, a script that cleans up under a shield would wait forever for an arm or the clock
            self.driver.abandon(f"the simulation has ended: {error}")
            clock.autojump_threshold = 0.0
            raise


def simulated(station: Station, rng: np.random.Generator) -> SimLaboratory:
    """Return a simulated laboratory in a session drawn from the generator, with nothing on its table."""
    return SimLaboratory(draw_session(station, rng), rng=rng)
