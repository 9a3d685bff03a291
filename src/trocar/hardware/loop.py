"""The loop that drives real arms, tick by tick.

Each tick computes the next set-points of all arms, sends them, reads the encoders, and checks the readings. The
motions' own time advances by one period per tick, however late the tick is. So a late loop slows motions down, never
speeds them up, and set-points stay within the limits. Any fault brakes the arm on its path and is reported.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.cell import JointReading, MotionEnd
from trocar.errors import ArmMoving, StartMismatch, TrocarError
from trocar.hardware.arm import PASSING, ArmFault, Connect, DrivenArm, Fault, HardwareArm, LoopSettings
from trocar.hardware.messages import ArmReport, Clear, Close, Emergency, Jaw, Report, Start, Stop
from trocar.robots.driver import Completion, Driver
from trocar.robots.executor import Ending

START_TOLERANCE = 1e-6
STEP_TOLERANCE = 1e-6
"""Share by which rounding may make a set-point exceed a limit."""
LATE_SHARE = 0.5


class HardwareLoop:
    """Drives arms tick by tick.

    Args:
        arms: by name.
        connect: connects one of them.
        settings: timing and tolerances.
    """

    def __init__(self, arms: Mapping[str, DrivenArm], connect: Connect, settings: LoopSettings):
        self.settings, self._arms = settings, dict(arms)
        self._ticks = 0
        self.driver = Driver(lambda: self._ticks * settings.tick_s, records=False)
        self.inbox: queue.SimpleQueue[object] = queue.SimpleQueue()
        self.closed = False
        self._devices: dict[str, HardwareArm] = {}
        self._targets: dict[str, tuple[NDArray[np.float64], ...]] = {}
        self._sent: dict[str, deque[NDArray[np.float64]]] = {}
        self._velocity: dict[str, NDArray[np.float64]] = {}
        self._read: dict[str, JointReading] = {}
        self._faults: dict[str, ArmFault] = {}
        self._dead: set[str] = set()
        self._waiting: dict[tuple[int, str], Completion] = {}
        self._jaw_goals: dict[str, float] = {}
        self._to_come: list[Start] = []
        self._late: deque[float] = deque()
        self._heard_s = time.monotonic()
        self._braked: dict[str, bool] = dict.fromkeys(arms, False)
        self._closing = False
        self._report = Report(0, 0.0, 0.0)
        try:
            self._attach(connect, 1 + int(np.ceil(settings.lag_s / settings.tick_s)))
        except BaseException:
            self.close()
            raise

    def _attach(self, connect: Connect, lag: int) -> None:
        """Connect all arms, and take what each holds as its first set-point; ``lag`` set-points are remembered."""
        for name in self._arms:
            self._devices[name] = connect(name)
        for name, arm in self._arms.items():  # connecting takes a while, and these must be fresh
            q, jaw_rad = self._devices[name].commanded()
            q = np.array(q, dtype=np.float64)
            if q.shape != (6,) or not np.isfinite(np.append(q, jaw_rad)).all():
                raise ArmFault(name, Fault.INVALID, f"its controller holds {q}, jaw {jaw_rad}")
            self.driver.attach(name, arm.model, arm.limits, q, jaw_rad)
            self._sent[name] = deque([q], maxlen=lag)
            self._velocity[name] = np.zeros(6)
            self._jaw_goals[name] = jaw_rad
            off = np.abs(np.array(self._devices[name].read().q, dtype=np.float64) - q)
            most = arm.following(self.settings)
            if (off > most).any():
                worst = int(np.argmax(off - most))
                joint = arm.model.joints[worst]
                reads = f"{joint.name!r} reads {off[worst]:.4f} {joint.unit} off what its controller holds"
                raise ArmFault(name, Fault.FOLLOWING, f"nothing was sent yet, and {reads}")

    def tick(self, late_s: float = 0.0) -> Report:
        """Send the next set-points, read and check the encoders; return the tick's report."""
        behind = any(getattr(self._devices[name], "behind", False) for name in self._arms if name not in self._dead)
        tick = self._ticks if behind else self._ticks + 1
        self._report = Report(tick, tick * self.settings.tick_s, time.monotonic())
        self._hear()
        self._watch(late_s)
        at_rest = not behind and all(self.driver.idle(name) for name in self._arms)
        if not behind:  # else the motions wait, and the last set-point is sent again
            self._take_over()
            ahead = np.array([tick * self.settings.tick_s])
            self._targets = {name: self.driver.targets(name, ahead) for name in self._arms}
            self._ticks = tick
        for name in self._arms:
            self._send(name, *self._targets[name])
        self._read |= {name: reading for name in self._arms if (reading := self._reading(name)) is not None}
        if not behind:
            self.driver.note(self._ticks * self.settings.tick_s, self._read)
        self._tell()
        if self._closing and at_rest:  # since before this tick, so the final set-point was sent once more
            self.close()
        return self._report

    def close(self) -> None:
        """Close the connections to the arms; do nothing if they are closed."""
        if self.closed:
            return
        self.closed = True
        for device in self._devices.values():
            with contextlib.suppress(Exception):
                device.close()

    def _hear(self) -> None:
        """Execute the messages of the scripts' process."""
        while not self.inbox.empty():
            said = self.inbox.get()
            self._heard_s = time.monotonic()
            match said:
                case Start():
                    self._start(said)
                case Jaw():
                    self._start_jaw(said)
                case Stop():
                    self._stop(said.arms or tuple(self._arms), said.ended, said.reason)
                case Emergency():
                    self._fault_all(Fault.EMERGENCY, said.detail)
                case Clear():
                    self._clear(said.arms or tuple(self._arms))
                case Close():
                    self._closing = True
                    self._stop(tuple(self._arms), MotionEnd.HELD, "the loop is closed")
                case None:  # the connection has ended
                    self._closing = True
                    self._fault_all(Fault.ORPHANED)

    def _start_jaw(self, jaw: Jaw) -> None:
        """Drive jaws, or stop them if they still execute this command; refuse if the arm may not move."""
        stopped = self._faults.get(jaw.arm) or (ArmFault(jaw.arm, Fault.GONE) if self._closing else None)
        if stopped is not None:
            self._report.over.append((jaw.key, jaw.arm, Ending(MotionEnd.FAULT, stopped)))
            return
        angle_rad = jaw.angle_rad
        if angle_rad is None:
            known = self._waiting.get((jaw.key, jaw.arm))
            if known is None or known.over.is_set():  # it is over, or another command has replaced it
                return
            angle_rad = self.driver.jaw_command_rad(jaw.arm)
        self._waiting[jaw.key, jaw.arm] = self.driver.start_jaw(jaw.arm, angle_rad)
        self._jaw_goals[jaw.arm] = angle_rad

    def _clear(self, arms: Iterable[str]) -> None:
        """Forget faults, except of arms to which nothing is sent any more."""
        for name in arms:
            if name not in self._dead:
                self._faults.pop(name, None)

    def _start(self, start: Start) -> None:
        """Start motions, keep them for their tick, or refuse them."""
        faulty = [self._faults[name] for name in start.motions if name in self._faults]
        if faulty:
            self._report.over += [(start.key, name, Ending(MotionEnd.FAULT, faulty[0])) for name in start.motions]
        elif self._closing:
            gone = Ending(MotionEnd.FAULT, ArmFault(next(iter(start.motions)), Fault.GONE))
            self._report.over += [(start.key, name, gone) for name in start.motions]
        elif start.at_tick is not None and start.at_tick >= self._ticks:
            self._to_come.append(start)
        elif (refusal := self._refusal(start)) is not None:
            self._report.refused.append((start.key, refusal))
        else:
            self._begin(start)

    def _refusal(self, start: Start) -> TrocarError | None:
        """Return why motions cannot start now: an arm moves, or is elsewhere."""
        for name, motion in start.motions.items():
            now = self.driver.setpoint(name)
            if now.moving and start.at_tick is None:
                return ArmMoving(name)
            first = motion.times_s[0]
            jump = float(np.abs(motion(first) - now.q).max())
            kick = np.abs(motion(first, 1) - now.velocity) - self._arms[name].limits.acceleration * self.settings.tick_s
            if jump > START_TOLERANCE or (kick > 0).any():
                far = f"{jump:.6f} rad (or m) away from" if jump > START_TOLERANCE else "with another velocity than"
                problem = f"starts {far} its set-point, or comes too late to take over"
                return StartMismatch(name, problem, "plan it from its set-point")
        return None

    def _begin(self, start: Start) -> None:
        for name, completion in self.driver.start(start.motions).items():
            self._waiting[start.key, name] = completion
            self._braked[name] = False

    def _take_over(self) -> None:
        """Start the motions whose tick has come."""
        for start in [start for start in self._to_come if start.at_tick == self._ticks]:
            self._to_come.remove(start)
            refusal = self._refusal(start)
            if refusal is None:
                self._begin(start)
            else:
                self._report.refused.append((start.key, refusal))

    def _watch(self, late_s: float) -> None:
        """Stop moving arms if the loop is late, or the scripts' process is silent."""
        now, settings = time.monotonic(), self.settings
        if late_s > LATE_SHARE * settings.tick_s:
            self._late.append(now)
        while self._late and self._late[0] < now - 1.0:
            self._late.popleft()
        silent_s = now - self._heard_s
        for name in self._arms:
            if self.driver.idle(name) or self.driver.braking(name):
                continue
            if late_s > settings.max_stall_s:
                self._fault(name, Fault.LATE, f"one tick by {late_s:.3f} s, more than {settings.max_stall_s:g} s")
            elif len(self._late) > settings.max_late:
                self._fault(name, Fault.LATE, f"{len(self._late)} ticks in a second, more than {settings.max_late}")
            elif silent_s > settings.watchdog_s and not self._closing:
                self._fault(name, Fault.WATCHDOG, f"for {silent_s:.2f} s, more than {settings.watchdog_s:g} s")

    def _send(
        self, name: str, q: NDArray[np.float64], velocity: NDArray[np.float64], jaw_rad: NDArray[np.float64]
    ) -> None:
        """Send a set-point, unless it is beyond the limits, which would be a bug in this package."""
        if name in self._dead:
            return
        arm, step = self._arms[name], q[-1] - self._sent[name][-1]
        bound = arm.limits.velocity * self.settings.tick_s
        change = np.abs(velocity[-1] - self._velocity[name]) / (arm.limits.acceleration * self.settings.tick_s)
        # twice: a motion may take over with a jump of velocity, which _refusal bounds
        if not (
            np.all(np.abs(step) <= bound * (1 + STEP_TOLERANCE) + 1e-12) and change.max() <= 2 * (1 + STEP_TOLERANCE)
        ):
            self._dead.add(name)
            self._fault(name, Fault.STEP, f"a step of {np.abs(step / bound).max():.3f} of its limit")
            return
        try:
            self._devices[name].send(q[-1], velocity[-1], float(jaw_rad[-1]))
        except Exception as error:
            self._dead.add(name)
            self._fault(name, Fault.DEVICE, f"send: {type(error).__name__}: {error}")
            return
        self._sent[name].append(q[-1])
        self._velocity[name] = velocity[-1]

    def _reading(self, name: str) -> JointReading | None:
        """Return an arm's reading, or None; stop an arm without a valid one, or that does not follow."""
        if name in self._dead:
            return None
        try:
            read = self._devices[name].read()
            q, jaw_rad, age_s = np.array(read.q, dtype=np.float64), float(read.jaw_rad), float(read.age_s)
        except ArmFault as error:
            self._fault(name, error.fault, error.detail)
            return None
        except Exception as error:
            self._fault(name, Fault.DEVICE, f"read: {type(error).__name__}: {error}")
            return None
        if q.shape != (6,) or not np.isfinite([*q, jaw_rad, age_s]).all():
            self._fault(name, Fault.INVALID, f"{q}, jaw {jaw_rad}, age {age_s}")
            return None
        if age_s > self.settings.stale_s:
            self._fault(name, Fault.STALE, f"for {age_s:.3f} s, more than {self.settings.stale_s:g} s")
            return None
        off = np.abs(np.array(self._sent[name]) - q).min(axis=0)
        most = self._arms[name].following(self.settings)
        if (off > most).any() and name not in self._faults:
            worst = int(np.argmax(off - most))
            joint = self._arms[name].model.joints[worst]
            lately = f"{off[worst]:.4f} off all that it was sent in the last {self.settings.lag_s:g} s"
            reads = f"joint {joint.name!r} reads {q[worst]:.4f} {joint.unit}"
            self._fault(name, Fault.FOLLOWING, f"{reads}, {lately}, more than {most[worst]:g}")
        return JointReading(self._ticks * self.settings.tick_s - age_s, q, jaw_rad)

    def _stop(self, arms: Iterable[str], ended: MotionEnd, reason: TrocarError | str) -> None:
        """Bring arms to rest, and refuse the motions that wait to take over."""
        for start in [start for start in self._to_come if set(start.motions) & set(arms)]:
            self._to_come.remove(start)
            why = reason if isinstance(reason, TrocarError) else ArmMoving(next(iter(start.motions)))
            self._report.refused.append((start.key, why))
        for name in arms:
            if ended is MotionEnd.FAULT:
                self.driver.fault(name, reason=reason)
            elif ended is MotionEnd.CANCELLED:
                self.driver.cancel(name)
            else:
                self.driver.hold(name, reason=reason)

    def _fault(self, name: str, fault: Fault, detail: str = "") -> None:
        """Stop an arm because something is wrong; report a fault that stays only once."""
        told = self._faults.get(name)
        if told is not None and told.fault is fault:
            return
        found = ArmFault(name, fault, detail)
        if fault not in PASSING:
            self._faults[name] = found
        self._report.faults.append(found)
        self._stop([name], MotionEnd.FAULT, found)

    def _fault_all(self, fault: Fault, detail: str = "") -> None:
        for name in self._arms:
            self._fault(name, fault, detail)

    def _tell(self) -> None:
        """Complete the report of a tick."""
        report, lead_s = self._report, self.settings.lead_ticks * self.settings.tick_s
        for key, completion in list(self._waiting.items()):
            if completion.over.is_set():
                report.over.append((*key, completion.ending))
                del self._waiting[key]
        for name in self._arms:
            braking = self.driver.braking(name)
            remaining = self.driver.remaining(name) if braking and not self._braked[name] else None
            self._braked[name] = braking
            report.arms[name] = ArmReport(
                np.append(self._sent[name][-1], self.driver.jaw_command_rad(name)),
                self.driver.read(name),
                self.driver.setpoint(name, lead_s),
                remaining,
                self._jaw_goals[name],
                self.driver.limit_use(name),
            )
