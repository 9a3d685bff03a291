"""A laboratory of real arms: the same scripts as in the simulated one, on the machine's clock."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Self

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.cell import Camera, Cell, Result, Robot
from trocar.errors import UnknownName
from trocar.geometry import SE3
from trocar.hardware.arm import Connect, DrivenArm, LoopSettings
from trocar.hardware.messages import Report
from trocar.hardware.robot import HardwareRobot
from trocar.lab import Station, StationArm, StationCamera
from trocar.log import CellLog
from trocar.robots import ArmGuard, Guarded, JointEstimator
from trocar.robots.concurrency import cause_of
from trocar.robots.driver import TICK_S


class WallClock:
    """The machine's monotonic clock, counted from ``origin_s``."""

    def __init__(self, origin_s: float):
        self.origin_s = origin_s

    def now_s(self) -> float:
        """Return the time since the cell was started."""
        return time.monotonic() - self.origin_s

    async def sleep(self, seconds: float) -> None:
        """Let time pass."""
        await trio.sleep(seconds)

    async def compute(self, function: Callable[[], Result], budget_s: float) -> tuple[Result, float]:
        """Run a function in a thread beside the scripts; return its result and the time that it took, s."""
        begin = time.perf_counter()
        result = await trio.to_thread.run_sync(function)
        return result, time.perf_counter() - begin


def registered(thing: StationArm | StationCamera) -> SE3:
    """Return the pose in the world of an arm's base or a camera: as registered, or else the station's nominal one."""
    if isinstance(thing, StationArm):
        return thing.T_world_base if thing.T_world_base_registered is None else thing.T_world_base_registered
    return thing.T_world_camera if thing.T_world_camera_registered is None else thing.T_world_camera_registered


class HardwareRecord:
    """What was requested of real arms, sent to them, and read from them: one row per tick of the loop.

    The true joints of real arms are not known.

    Attributes:
        asked_of: the outermost robot, whose set-points are what the script requested.
    """

    def __init__(self, arms: Sequence[str]):
        self.asked_of: Robot | None = None
        self._times: list[float] = []
        self._rows: dict[str, list[NDArray[np.float64]]] = {name: [] for name in arms}

    def take(self, report: Report) -> None:
        """Add the row of a tick."""
        if self.asked_of is None:
            return
        self._times.append(report.time_s)
        for name, arm in report.arms.items():
            asked = self.asked_of.setpoint(name).q
            reading = arm.reading
            self._rows[name].append(np.concatenate([asked, arm.sent[6:], arm.sent, reading.q, [reading.jaw_rad]]))

    def arrays(self, origin_s: float, lead_s: float) -> dict[str, NDArray[np.float64]]:
        """Return (n, 7) ``desired_ARM``, ``commanded_ARM`` and ``measured_ARM`` at 100 Hz: joints and jaw.

        A row has what was last sent and read by its time, so late ticks leave no gap. The last row has the last report.

        Args:
            origin_s: the machine's monotonic clock at the first row.
            lead_s: how far the requested set-points are ahead of those sent.
        """
        times_s = np.array(self._times) - origin_s
        if not len(times_s):
            kinds = ("desired", "commanded", "measured")
            return {f"{kind}_{name}": np.zeros((0, 7)) for kind in kinds for name in self._rows}
        grid_s = TICK_S * np.arange(math.ceil(max(times_s[-1], 0.0) / TICK_S - 1e-9) + 1)
        now = np.clip(np.searchsorted(times_s, grid_s, side="right") - 1, 0, None)
        asked = np.clip(np.searchsorted(times_s + lead_s, grid_s, side="right") - 1, 0, None)
        found = {}
        for name, rows in self._rows.items():
            table = np.array(rows)
            found[f"desired_{name}"] = np.column_stack([table[asked, :6], table[now, 6]])
            found[f"commanded_{name}"], found[f"measured_{name}"] = table[now, 7:14], table[now, 14:]
        return found


class HardwareLaboratory:
    """Real arms of a station, ready to run scripts; a context manager that leaves the arms holding.

    A loop in its own process (``trocar.hardware.process``) drives the arms, behind a guard. However a script ends, the
    arms come to rest within their limits.

    Attributes:
        station: of the arms.
        cell: what scripts are given; poses of bases and cameras are the registered ones, where the station has them.
        robot: the arms without their guard, for the emergency stop and faults.
        log: events of scripts, guard and loop.
        record: what was requested, sent and read, tick by tick.
        cameras: by name.
    """

    def __init__(
        self,
        station: Station,
        connect: Connect,
        settings: LoopSettings | None = None,
        *,
        cameras: Mapping[str, Camera] | None = None,
        listener: Callable[[Mapping[str, object]], None] | None = None,
    ):
        """Connect the station's arms.

        Args:
            station: names the arms, their limits, bases and workspaces.
            connect: connects an arm by its name; called in the loop's process, so it must be a module-level function
                or class (or a ``functools.partial`` of one).
            settings: of the loop.
            cameras: by their names in the station, which has their poses.
            listener: called with each event of the log.

        Raises:
            TrocarError: an arm could not be connected, or the station lacks a camera.
        """
        self.station = station
        for name in cameras or {}:  # before anything is connected
            if name not in station.cameras:
                raise UnknownName("camera", name, station.cameras)
        driven = {name: DrivenArm(arm.model, arm.limits) for name, arm in station.arms.items()}
        clock = WallClock(time.monotonic())
        self.log = CellLog(clock.now_s, listener=listener)
        self.record = HardwareRecord(tuple(driven))
        self.robot = HardwareRobot(driven, connect, settings, note=self.log.event, record=self.record.take)
        bases = {name: registered(arm) for name, arm in station.arms.items()}
        guards = {
            name: ArmGuard(arm.model, arm.limits, bases[name], arm.workspace_m) for name, arm in station.arms.items()
        }
        self._guard = Guarded(
            self.robot,
            guards,
            min_distance_m=station.min_distance_m,
            stale_s=self.robot.settings.stale_s,
            note=self.log.event,
        )
        self.record.asked_of, self.cameras = self._guard, dict(cameras or {})
        self.cell = Cell(
            robot=self._guard,
            cameras=cameras or {},
            arms=station.models,
            limits=station.limits,
            T_world_base_registered=bases,
            T_world_camera_registered={name: registered(station.cameras[name]) for name in cameras or {}},
            T_world_fixture=station.T_world_fixture,
            clock=clock,
            log=self.log,
        )
        clock.origin_s = self.robot.origin_s = time.monotonic()

    def wrap_robot(self, wrap: Callable[[Cell], Any]) -> Cell:
        """Replace the cell's robot by ``wrap(cell)``, a wrapper around it; return the new cell."""
        robot = self.record.asked_of = wrap(self.cell)
        self.cell = replace(self.cell, robot=robot)
        if isinstance(robot, JointEstimator):
            self._guard.estimator = robot
        return self.cell

    def run(self, script: Callable[[Cell], Awaitable[Any]], budget_s: float) -> bool:
        """Run a script to its end; return whether it ended within its budget. Afterwards every arm is at rest.

        Raises:
            BaseException: whatever the script raises, and ``ArmFault`` if the loop's process has ended.
        """
        try:
            return trio.run(self._run, script, budget_s)
        except BaseException as error:
            raise cause_of(error) from None

    async def _run(self, script: Callable[[Cell], Awaitable[Any]], budget_s: float) -> bool:
        ended, resting = False, trio.CancelScope(shield=True)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._attend, nursery, resting)
            try:
                with trio.move_on_after(budget_s):
                    await self.robot.fresh()  # the last report may date from when the arms were connected
                    await script(self.cell)
                    ended = True
            finally:
                try:
                    with trio.CancelScope(shield=True):
                        self.cell.robot.hold(reason="the script has ended")
                        await self.cell.robot.rest()
                finally:  # a second Ctrl-C may come here, too
                    nursery.cancel_scope.cancel()
                    resting.cancel()
        return ended

    async def _attend(self, nursery: trio.Nursery, resting: trio.CancelScope) -> None:
        """Process the loop's reports until the nursery is cancelled.

        If that raises (Ctrl-C may come here, and a listener may fail), the script ends, and reports are processed
        within ``resting`` until its arms are at rest, without the listener.
        """
        try:
            await self.robot.attend(self._guard.check)
        except BaseException:
            if not nursery.cancel_scope.cancel_called:
                self.log.listener = None
                nursery.cancel_scope.cancel()
                with resting:
                    while self.robot.gone is None and not resting.cancel_called:
                        with suppress(BaseException):  # Ctrl-C again: the arms must still come to rest
                            await self.robot.attend()
            raise

    def close(self) -> None:
        """Bring the arms to rest, leave them holding, and end their loop."""
        self.robot.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
