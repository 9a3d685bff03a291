"""What every robot has to do: the promises of ``trocar.cell.Robot`` on which agents rely."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

import numpy as np
import trio
from numpy.typing import NDArray

from trocar.arms import MotionLimits
from trocar.cell import Cell, MotionEnd, MotionResult
from trocar.errors import MotionRefused, TrocarError
from trocar.motion import move_to, rest_to_rest
from trocar.testing.requirement import CheckFailed, require
from trocar.trajectory import Trajectory

BUSY_S = 0.3


async def check_robot(
    cell: Cell, arm: str, *, span: float = 0.05, tolerance: float = 0.02, limits: MotionLimits | None = None
) -> None:
    """Check one arm of a cell: it **moves**, every joint by a share of its range and back, and its jaws.

    Run it as a script of the cell: ``laboratory.run(lambda cell: check_robot(cell, "psm1"))`` in a simulated one, in
    your loop's nursery on hardware.

    Args:
        cell: the cell whose robot is checked.
        arm: name of the arm.
        span: share of each joint's range, towards its middle, by which the arm moves.
        tolerance: how far from the command the encoders may read at rest, as a share of a joint's range.
        limits: limits of the motions; None: those that the arm keeps in its cell.

    Raises:
        CheckFailed: the robot breaks a requirement; the message says which.
    """
    check = _RobotCheck(cell, arm, span, tolerance, limits or cell.limits[arm])
    await check.moves_and_tells()
    await check.refuses_what_does_not_start_here()
    await check.is_not_hurried_by_a_busy_script()
    await check.is_held()
    await check.is_cancelled()
    await check.is_replaced()
    await check.drives_its_jaws()


class HeldByCheck(TrocarError):
    """The reason with which the check holds an arm."""


class _RobotCheck:
    def __init__(self, cell: Cell, arm: str, span: float, tolerance: float, limits: MotionLimits):
        self.cell, self.robot, self.arm, self.limits = cell, cell.robot, arm, limits
        self.subject, self.model = f"arm {arm!r} of the robot", cell.arms[arm]
        self.tolerances = tolerance * (self.model.upper - self.model.lower)
        self.home = self.robot.setpoint(arm).q.copy()
        towards = np.where(self.home > self.model.middle, -1.0, 1.0)
        self.away = self.home + towards * span * (self.model.upper - self.model.lower)

    async def moves_and_tells(self) -> None:
        """A motion runs to its end on the cell's clock, and its result reports what was commanded."""
        here = self.robot.setpoint(self.arm)
        require(not here.moving and not here.velocity.any(), self.subject, "be at rest when its check begins")
        for goal in (self.away, self.home):
            begin_s, motion = self.cell.clock.now_s(), self._motion_to(goal)
            result = (await self.robot.move({self.arm: motion}))[self.arm]
            took_s = self.cell.clock.now_s() - begin_s
            require(result.done and not result.reason, self.subject, f"run a motion to its end; {result.reason}")
            self._check_result(result)
            least_s = 0.98 * motion.duration_s
            require(took_s >= least_s, self.subject, f"take {motion.duration_s:.2f} s for a motion, not {took_s:.2f} s")
            self._check_rest_at(goal)

    async def refuses_what_does_not_start_here(self) -> None:
        """A motion that starts elsewhere is refused with ``MotionRefused``, and nothing moves."""
        before = self.robot.setpoint(self.arm).q
        elsewhere = rest_to_rest(self.away, self.home, self.limits)
        await self._refused({self.arm: elsewhere}, "refuse a motion that starts elsewhere")
        require(np.array_equal(self.robot.setpoint(self.arm).q, before), self.subject, "stay where it refused a motion")

    async def is_not_hurried_by_a_busy_script(self) -> None:
        """A script that computes without yielding may make a motion slower, but never faster."""
        async with self._running(self._motion_to(self.away), 0.25) as results:
            time.sleep(BUSY_S)
        (result,) = results
        require(result.done, self.subject, f"run a motion to its end while its script computes; {result.reason}")
        self._check_result(result)
        await self._home()

    async def is_held(self) -> None:
        """A moving arm refuses another motion, brakes when it is held, and reports that it was held."""
        motion, why = self._motion_to(self.away), HeldByCheck("check_robot holds the arm")
        async with self._running(motion, 0.5) as results:
            require(self.robot.setpoint(self.arm).moving, self.subject, "say that it moves while a motion runs")
            await self._refused({self.arm: motion}, "refuse a motion while another one runs")
            self.robot.hold(self.arm, reason=why)
            await self.robot.rest(self.arm)
            self._check_rest()
        (result,) = results
        said = result.ended is MotionEnd.HELD and isinstance(result.cause, HeldByCheck)
        require(said, self.subject, f"end a held motion as HELD with the reason given, not {result.ended}")
        self._check_result(result)
        await self._home()

    async def is_cancelled(self) -> None:
        """The arm comes to rest before the cancellation goes on."""
        motion = self._motion_to(self.away)
        with trio.CancelScope() as scope:
            async with trio.open_nursery() as nursery:

                async def cancel() -> None:
                    await self.cell.clock.sleep(motion.duration_s / 2)
                    scope.cancel()

                nursery.start_soon(cancel)
                await self.robot.move({self.arm: motion})
        require(scope.cancelled_caught, self.subject, "let a cancellation through")
        self._check_rest()
        await self._home()

    async def is_replaced(self) -> None:
        """Another motion takes over without a stop; the first one returns as replaced."""
        async with self._running(self._motion_to(self.away), 0.5) as results:
            now = self.robot.setpoint(self.arm)
            back = move_to(now.q, now.velocity, self.home, self.limits)
            result = (await self.robot.replace({self.arm: back}))[self.arm]
        ends = [one.ended for one in results]
        require(ends == [MotionEnd.REPLACED], self.subject, f"end a replaced motion as REPLACED, not {ends}")
        require(result.done, self.subject, f"run the motion that takes over to its end; {result.reason}")
        self._check_rest_at(self.home)

    async def drives_its_jaws(self) -> None:
        """The jaws reach the commanded angle; stalling on an object is not checked."""
        jaw = self.model.jaw
        for share in (0.6, 0.2):
            angle_rad = share * jaw.upper  # jaws close at 0; a range below that is not used
            result = await self.robot.jaw(self.arm, angle_rad)
            require(result.done, self.subject, f"drive its jaws to {angle_rad:.2f} rad; {result.reason}")
            read_rad = self.robot.read(self.arm).jaw_rad
            near = math.isfinite(read_rad) and abs(read_rad - angle_rad) < 0.1
            require(near, self.subject, f"read {angle_rad:.2f} rad of its jaws there, not {read_rad:.2f}")

    @asynccontextmanager
    async def _running(self, motion: Trajectory, share: float) -> AsyncIterator[list[MotionResult]]:
        """Run a motion, and the body once this share of its time is over; then the list has the motion's result."""
        results: list[MotionResult] = []

        async def run() -> None:
            results.append((await self.robot.move({self.arm: motion}))[self.arm])

        async with trio.open_nursery() as nursery:
            nursery.start_soon(run)
            await self.cell.clock.sleep(share * motion.duration_s)
            yield results

    def _motion_to(self, goal: NDArray[np.float64]) -> Trajectory:
        return rest_to_rest(self.robot.setpoint(self.arm).q, goal, self.limits)

    async def _home(self) -> None:
        await self.robot.move({self.arm: self._motion_to(self.home)})
        self._check_rest_at(self.home)

    async def _refused(self, motions: Mapping[str, Trajectory], requirement: str) -> None:
        try:
            await self.robot.move(motions)
        except MotionRefused:
            return
        except TrocarError as error:
            raise CheckFailed(f"{self.subject} must: {requirement} with MotionRefused, not {error!r}") from error
        raise CheckFailed(f"{self.subject} must: {requirement}")

    def _check_rest(self) -> None:
        now = self.robot.setpoint(self.arm)
        require(not now.moving and not now.velocity.any(), self.subject, "be at rest after it was stopped")

    def _check_rest_at(self, goal: NDArray[np.float64]) -> None:
        self._check_rest()
        at, read = self.robot.setpoint(self.arm).q, self.robot.read(self.arm)
        require(np.allclose(at, goal, atol=1e-6), self.subject, "have its set-point where its motion ended")
        known = read.q.shape == (6,) and np.isfinite(read.q).all() and abs(read.time_s - self.cell.clock.now_s()) < 0.5
        require(known, self.subject, f"read six joints, not longer than .5 s ago: {read}")
        off = np.abs(read.q - goal)
        require(np.all(off < self.tolerances), self.subject, f"read what was commanded at rest; it is {off} off")

    def _check_result(self, result: MotionResult) -> None:
        n = len(result.times_s)
        whole = result.commanded.shape == result.measured.shape == (n, 7) and n > 1
        require(whole, self.subject, "return what it commanded and measured, a row of six joints and the jaw a time")
        forward = np.all(np.diff(result.times_s) > 0)
        require(forward, self.subject, "return times that run forward")
        steps_s = np.diff(result.times_s)  # two reports may arrive closer together than they were sent
        velocity = np.diff(result.commanded[:, :6], axis=0) / np.maximum(steps_s, np.median(steps_s))[:, None]
        use = float(np.max(np.abs(velocity) / self.limits.velocity))
        require(use < 1.05, self.subject, f"command no more than the limits of velocity, not {use:.2f} of them")
