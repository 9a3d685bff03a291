"""Real arms behind the ``Robot`` protocol: the scripts' side of the loop that drives them in another process."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import pickle
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import trio

from trocar.cell import JointReading, MotionEnd, MotionResult, SetPoint
from trocar.errors import ArmMoving, InvalidInput, TrocarError, UnknownName
from trocar.hardware.arm import PASSING, ArmFault, Connect, DrivenArm, Fault, LoopSettings
from trocar.hardware.jobs import Job, Jobs
from trocar.hardware.messages import Alive, ArmReport, Clear, Close, Emergency, Jaw, Report, Start, Stop
from trocar.hardware.process import serve
from trocar.robots.driver import JAW_REST_S
from trocar.trajectory import Trajectory

CONNECT_S = 20.0
"""The loop's process has this long to start and to connect all arms."""
STILL_RAD = 1e-3
"""Jaws that turn by less than this in ``JAW_REST_S`` have stopped."""
MOVED_RAD = 5e-3
"""Jaws whose reading changes by more than this have moved."""
ALIVE_S = 0.1
"""Period of the signs of life."""
SILENT_S = 2.0
"""A loop that has reported nothing for this long does not drive its arms any more."""


class HardwareRobot:
    """Arms that a loop in its own process drives (``trocar.hardware.process``), to be wrapped in ``Guarded``.

    ``read``, ``setpoint`` and ``remaining`` return what the loop last reported. The set-point of a moving arm is that
    of ``lead_ticks`` later, so a motion that takes over there reaches the loop in time. A late one is refused.

    Args:
        arms: by name.
        connect: called with each name in the loop's process; a module-level function, or a ``functools.partial``.
        settings: of the loop.
        note: called as ``note("fault", arm=..., ...)`` with each fault.
        record: called with each report of the loop, after it was processed.

    Attributes:
        settings: of the loop.
        origin_s: time of the machine's monotonic clock from which the cell's time counts.
        gone: why the loop does not drive the arms any more; None: it does.
        refused: the last fault after which an arm refuses to move; None: there is none.

    Raises:
        TrocarError: an arm could not be connected, with the reason, or ``connect`` is not such a function.
    """

    def __init__(
        self,
        arms: Mapping[str, DrivenArm],
        connect: Connect,
        settings: LoopSettings | None = None,
        *,
        note: Callable[..., None] = lambda name, **values: None,
        record: Callable[[Report], None] = lambda report: None,
    ):
        self.settings, self.origin_s = settings or LoopSettings(), 0.0
        self._note, self._record, self._jobs = note, record, Jobs()
        self.gone: ArmFault | None = None
        self.refused: ArmFault | None = None
        self._refuses = trio.Event()
        context = multiprocessing.get_context("spawn")
        said, self._say = context.Pipe(duplex=False)
        self._told, told = context.Pipe(duplex=False)
        given = dict(arms), connect, self.settings, said, told
        self._process = context.Process(target=serve, args=given, name="hardware loop", daemon=False)
        try:
            self._process.start()
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            remedy = "give a module-level function, or a functools.partial of one"
            raise InvalidInput("connect", f"cannot be given to the loop's process ({error})", remedy) from None
        said.close()
        told.close()
        try:
            self._connect(next(iter(arms)))
        except BaseException:  # Ctrl-C too: an orphaned loop would stream for ever
            self._process.kill()
            self._process.join()
            self._say.close()
            self._told.close()
            raise

    def _connect(self, first: str) -> None:
        """Wait until the loop's process has connected all arms, and has told so in its first report."""
        deadline_s = time.monotonic() + CONNECT_S

        def told() -> Any:
            if not self._told.poll(max(0.0, deadline_s - time.monotonic())):
                raise ArmFault(first, Fault.DEVICE, f"its loop did not connect and begin within {CONNECT_S:g} s")
            return self._told.recv()

        try:
            problem = told()
            if problem is None:
                self._take(told())
        except EOFError:
            problem = "its process ended while connecting"
        if problem is not None:
            raise problem if isinstance(problem, TrocarError) else ArmFault(first, Fault.DEVICE, problem)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the arms."""
        return tuple(self._report.arms)

    def report(self, name: str) -> ArmReport:
        """Return the loop's last report on an arm."""
        if name not in self._report.arms:
            raise UnknownName("arm", name, self._report.arms)
        return self._report.arms[name]

    def _time_s(self, clock_s: float) -> float:
        """Convert a time of the motions, which late ticks delay, to the cell's time."""
        return clock_s - self._report.clock_s + self._report.time_s - self.origin_s

    def read(self, arm: str) -> JointReading:
        """Return the last encoder reading."""
        reading = self.report(arm).reading
        return replace(reading, time_s=self._time_s(reading.time_s))

    def setpoint(self, arm: str) -> SetPoint:
        """Return the present set-point at rest; in motion, the one where a motion that takes over must start."""
        now, time_s = self.report(arm).setpoint, self._time_s(self._report.clock_s)
        job = self._jobs.latest(arm)
        if job is not None and job.at_tick is not None and job.at_tick >= self._report.tick:
            # not begun yet: the next motion of a stream takes over from this one, without waiting for its start
            ticks = self._report.tick + self.settings.lead_ticks - job.at_tick
            motion = job.motions[arm]
            path_s = float(motion.times_s[0] + ticks * self.settings.tick_s)
            return SetPoint(time_s, motion(path_s), motion(path_s, 1), True, path_s, 1.0)
        return replace(now, time_s=time_s, moving=now.moving or job is not None)

    def remaining(self, arm: str, /) -> tuple[Trajectory, float] | None:
        """Return the motion that an arm is executing and the cell's time at its start; None at rest."""
        if not self.setpoint(arm).moving or arm not in self._jobs.executing:
            return None
        motion, start_s = self._jobs.executing[arm]
        return motion, self._time_s(start_s)

    def braking(self, arm: str, /) -> bool:
        """Return whether an arm is coming to rest before the end of its motion."""
        return arm in self._jobs.braking

    def widest_jaw_rad(self, arm: str, /) -> float:
        """Return the widest opening of an arm's jaws from now until they reach their goal."""
        return max(float(self.report(arm).sent[6]), self.report(arm).jaw_goal_rad)

    def limit_use(self, arm: str) -> tuple[float, float]:
        """Return the largest share of an arm's velocity and acceleration limits used so far."""
        return self.report(arm).limit_use

    async def move(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Run trajectories from rest, all starting at the same tick."""
        for name in motions:
            if self.setpoint(name).moving:
                raise ArmMoving(name)
        return await self._run(motions, None)

    async def replace(self, motions: Mapping[str, Trajectory]) -> Mapping[str, MotionResult]:
        """Let trajectories take over from what the arms are doing now."""
        return await self._run(motions, self._report.tick + self.settings.lead_ticks)

    def prepare(self, motions: Mapping[str, Trajectory]) -> None:
        """Do nothing: trajectories are executed as they are."""

    async def _run(self, motions: Mapping[str, Trajectory], at_tick: int | None) -> Mapping[str, MotionResult]:
        start_tick = self._report.tick if at_tick is None else at_tick
        job = self._jobs.begin(motions, motions, at_tick, start_tick * self.settings.tick_s)
        self._send(Start(job.key, dict(motions), at_tick))
        try:
            await job.over.wait()
        except trio.Cancelled:
            with trio.CancelScope(shield=True):
                await self._stopped(job)
            raise
        if job.refusal is not None:
            raise job.refusal
        return {name: job.result(name, self.origin_s) for name in motions}

    async def _stopped(self, job: Job) -> None:
        """Brake the motions of a cancelled call; return when they have ended.

        A motion that another one is to replace is left alone, but told to brake if that other one is refused.
        """
        told: set[str] = set()
        while not job.over.is_set():
            mine = {name for name in job.arms if self._jobs.executing.get(name) is job.began[name]} - told
            if mine:
                self._stop(tuple(sorted(mine)), MotionEnd.CANCELLED)
                told |= mine
            with trio.move_on_after(self.settings.tick_s):
                await job.over.wait()

    async def jaw(self, arm: str, angle_rad: float) -> MotionResult:
        """Ramp the jaws to this opening at their speed; return when they have arrived or stalled."""
        before_rad, way_rad = self.read(arm).jaw_rad, abs(angle_rad - float(self.report(arm).sent[6]))
        job = self._jobs.begin([arm])
        self._send(Jaw(job.key, arm, angle_rad))
        try:
            await job.over.wait()
        except trio.Cancelled:
            if not job.over.is_set():
                self._send(Jaw(job.key, arm, None))
            raise
        if job.endings[arm].ended is MotionEnd.DONE:
            await self._jaws_still(arm, before_rad if way_rad > MOVED_RAD else math.inf)
        return job.result(arm, self.origin_s)

    async def _jaws_still(self, arm: str, before_rad: float) -> None:
        """Return when the jaws' readings stand still, at the latest after ``lag_s`` and ``JAW_REST_S``.

        Readings come late over a network: jaws that still read as before the command have not begun to move. Time
        counts in the loop's ticks, since reports may also reach this process late.
        """
        rest, lag = (math.ceil(time_s / self.settings.tick_s) for time_s in (JAW_REST_S, self.settings.lag_s))
        end, read = self._report.tick + lag + rest, dict[int, float]()
        while self.gone is None and self._report.tick < end:
            now, now_rad = self._report.tick, self.read(arm).jaw_rad
            read[now] = now_rad
            since = max((tick for tick in read if tick <= now - rest), default=None)
            if since is not None and abs(now_rad - before_rad) > MOVED_RAD:
                lately_rad = [jaw_rad for tick, jaw_rad in read.items() if tick >= since]
                if max(lately_rad) - min(lately_rad) <= STILL_RAD:
                    return
            await trio.sleep(self.settings.tick_s)

    def _send(self, message: object) -> None:
        """Tell the loop; if it is gone, end every script's wait."""
        if self.gone is None:
            with contextlib.suppress(OSError):
                self._say.send(message)
                return
        self._abandon()

    def hold(self, *arms: str, reason: TrocarError | str = "") -> None:
        """Bring these arms, or all, to rest on their paths; their jaws stop too."""
        for name in arms:
            self.report(name)
        self._stop(arms, MotionEnd.HELD, reason)

    def fault(self, *arms: str, reason: TrocarError | str) -> None:
        """Bring these arms to rest because something is wrong."""
        self._stop(arms, MotionEnd.FAULT, reason)

    def _stop(self, arms: tuple[str, ...], ended: MotionEnd, reason: TrocarError | str = "") -> None:
        self._send(Stop(arms, ended, self._jobs.reason(reason)))

    def emergency_stop(self, reason: str = "") -> None:
        """Brake every arm; none moves again until its faults are cleared."""
        self._send(Emergency(reason))

    def clear_faults(self, *arms: str) -> None:
        """Let these arms, or all, move again after a fault; an arm whose connection failed has to be connected anew."""
        self.refused = None
        if self._refuses.is_set():  # else somebody may be waiting for it
            self._refuses = trio.Event()
        self._send(Clear(arms))

    async def refusal(self) -> None:
        """Wait for a fault after which an arm refuses to move.

        Raises:
            ArmFault: this fault.
        """
        while self.refused is None:
            await self._refuses.wait()
        raise self.refused

    async def rest(self, *arms: str) -> None:
        """Return when these arms, or all, are at rest."""
        for name in arms or self.names:
            while self.gone is None and self.setpoint(name).moving:
                await trio.sleep(self.settings.tick_s)

    async def attend(self, after: Callable[[], None] = lambda: None) -> None:
        """Process the loop's reports, for ever; call ``after`` after each batch.

        Raises:
            ArmFault: the loop's process has ended.
        """
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._live)
            while True:
                await trio.lowlevel.wait_readable(self._told.fileno())
                while (report := self._told_now()) is not None:
                    self._take(report)
                after()

    def _told_now(self) -> Report | None:
        """Return the next report, or None if none has come (ArmFault: the loop's process has ended)."""
        try:
            return self._told.recv() if self._told.poll() else None
        except (EOFError, OSError):
            raise self._abandon() from None

    async def _live(self) -> None:
        """Send signs of life, and watch for the loop's.

        Silence is counted in checks, not in time: if this process itself stood still, the loop is not to blame.
        """
        tick, silent_s = -1, 0.0
        while True:
            self._send(Alive())
            await trio.sleep(ALIVE_S)
            silent_s = 0.0 if self._report.tick != tick or self._told.poll() else silent_s + ALIVE_S
            tick = self._report.tick
            if silent_s > SILENT_S:
                self._process.kill()  # it receives nothing, and would go on sending when that call returns
                raise self._abandon(f"it has told nothing for {silent_s:.1f} s: a call of its driver does not return")

    async def fresh(self) -> None:
        """Return when a report later than this call, and all before it, are processed."""
        now_s = time.monotonic()
        while self.gone is None and self._report.time_s < now_s:
            await trio.sleep(self.settings.tick_s)

    def _take(self, report: Report) -> None:
        self._report: Report = report
        for fault in report.faults:
            if fault.fault not in PASSING:
                self.refused = fault
                self._refuses.set()
        self._jobs.take(report)
        self._record(report)
        for fault in report.faults:  # last: whoever is told may raise
            self._note_fault(fault)

    def _note_fault(self, fault: ArmFault) -> None:
        self._note("fault", arm=fault.arm, fault=fault.fault.name.lower(), reason=str(fault))

    def _abandon(self, detail: str = "") -> ArmFault:
        """End every script's wait, now and later: the loop is gone. Return this fault, which is noted once."""
        known, self.gone = self.gone, self.gone or ArmFault(self.names[0], Fault.GONE, detail)
        self._jobs.end(self.gone)
        if known is None:
            self._note_fault(self.gone)
        return self.gone

    def close(self, timeout_s: float = 10.0) -> None:
        """Bring the arms to rest, leave them holding, process the last reports, and end the loop's process."""
        self._send(Close())
        deadline_s = time.monotonic() + timeout_s
        try:
            with contextlib.suppress(EOFError, OSError):
                while self._told.poll(max(0.0, deadline_s - time.monotonic())):
                    self._take(self._told.recv())
        finally:  # a listener may raise
            self._process.join(max(0.0, deadline_s - time.monotonic()))
            if self._process.is_alive():
                self._process.kill()
            self.gone = self.gone or ArmFault(self.names[0], Fault.GONE)
            self._say.close()
            self._told.close()
