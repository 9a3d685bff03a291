"""Simulated arms behind the ``Robot`` protocol, on the trial's virtual clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import trio
from numpy.typing import NDArray
from trio.testing import MockClock, wait_all_tasks_blocked

from trocar.arms import ArmModel
from trocar.cell import Execution, JointReading
from trocar.errors import TrocarError
from trocar.sim.mjcf import TIMESTEP_S
from trocar.sim.transmission import Transmission
from trocar.sim.world import World
from trocar.trajectory import Trajectory

TICK_S = 0.010
"""Period of the arms' controller (paper, V-B: 10 ms)."""
SERVO_STEPS = 2
"""Physics steps between two updates of the servos' targets."""
SERVO_S = SERVO_STEPS * TIMESTEP_S
TICK_SERVOS = round(TICK_S / SERVO_S)
JAW_REST_S = 0.05
"""Time after the jaw's ramp until it holds still."""


@dataclass
class _Drive:
    """What one arm is doing now."""

    arm: ArmModel
    transmission: Transmission
    q_cmd: NDArray[np.float64]
    jaw_cmd: float
    q_target: NDArray[np.float64]
    path: Iterator[NDArray[np.float64]] | None = None
    ticks_left: int = 0
    jaw_goal: float = 0.0
    moved: trio.Event = field(default_factory=trio.Event)
    jaw_done: trio.Event = field(default_factory=trio.Event)

    @property
    def idle(self) -> bool:
        """Return whether neither the arm nor its jaws move on command."""
        return self.path is None and self.jaw_cmd == self.jaw_goal


class SimRobot:
    """Arms in the simulated world. Encoders read the commanded side of the cables."""

    def __init__(self, world: World, clock: MockClock):
        self.world = world
        self._clock = clock
        self._drives: dict[str, _Drive] = {}
        self._times: list[float] = []
        self._rows: dict[str, list[tuple[NDArray, NDArray]]] = {}

    def attach(self, name: str, transmission: Transmission, q_cmd: NDArray[np.float64], jaw_rad: float) -> None:
        """Put an arm at rest at the command (6,) and let its transmission drive it from now on."""
        q_joint = transmission.joints(q_cmd)
        self.world.place_arm(name, q_joint, jaw_rad)
        self._drives[name] = _Drive(
            arm=self.world.cell.arms[name],
            transmission=transmission,
            q_cmd=q_cmd.copy(),
            jaw_cmd=jaw_rad,
            q_target=q_joint,
            jaw_goal=jaw_rad,
        )
        self._rows[name] = []

    def _drive(self, arm: str) -> _Drive:
        if arm not in self._drives:
            raise TrocarError(f"arm {arm!r} is not in this cell; choose one of {', '.join(self._drives)}")
        return self._drives[arm]

    def read(self, arm: str) -> JointReading:
        """Return what the encoders say: the commanded side of the cables, and the jaw's motor."""
        drive = self._drive(arm)
        return JointReading(self.world.time_s, drive.q_cmd.copy(), self.world.jaw_rad(arm))

    async def move(self, arm: str, trajectory: Trajectory) -> Execution:
        """Run the trajectory from its start, which must be where the arm is commanded now (1 mrad, 1 mm)."""
        drive = self._drive(arm)
        if drive.path is not None:
            raise TrocarError(f"arm {arm!r} is already moving; await its motion before the next")
        jump = float(np.max(np.abs(trajectory(trajectory.times_s[0]) - drive.q_cmd)))
        if jump > 1e-3:
            raise TrocarError(
                f"the motion of arm {arm!r} starts {jump:.4f} rad (or m) away from where it is; start it there"
            )
        drive.ticks_left = max(1, int(np.ceil(trajectory.duration_s / TICK_S - 1e-9)))
        steps = TICK_SERVOS * drive.ticks_left
        drive.path = iter(trajectory(trajectory.times_s[0] + SERVO_S * np.arange(1, steps + 1)))
        drive.moved = trio.Event()
        first = len(self._times)
        await drive.moved.wait()
        return self._execution(arm, first)

    async def jaw(self, arm: str, angle_rad: float) -> Execution:
        """Ramp the jaws to this opening at their speed; return when they arrived or stall."""
        drive = self._drive(arm)
        lower, upper = drive.arm.jaw.lower, drive.arm.jaw.upper
        if not lower <= angle_rad <= upper:
            raise TrocarError(f"jaw angle {angle_rad:.4f} rad is outside [{lower:.4f}, {upper:.4f}] rad of arm {arm!r}")
        drive.jaw_goal, drive.jaw_done = angle_rad, trio.Event()
        first = len(self._times)
        await drive.jaw_done.wait()
        await trio.sleep(JAW_REST_S)
        return self._execution(arm, first)

    def hold(self, arm: str) -> None:
        """Stop this arm where it is commanded now."""
        drive = self._drive(arm)
        drive.path = None
        drive.jaw_goal = drive.jaw_cmd
        drive.moved.set()
        drive.jaw_done.set()

    def _execution(self, arm: str, first: int) -> Execution:
        rows = self._rows[arm][first:]
        return Execution(
            times_s=np.array(self._times[first:]),
            commanded=np.array([row[0] for row in rows]).reshape(-1, 7),
            measured=np.array([row[1] for row in rows]).reshape(-1, 7),
        )

    async def run_physics(self, each_tick: Callable[[], None]) -> None:
        """Turn the cell's clock: let every script run until it waits, then advance 10 ms; for ever."""
        while True:
            await wait_all_tasks_blocked()
            self._tick()
            each_tick()
            self._clock.jump(TICK_S)

    def _tick(self) -> None:
        for name, drive in self._drives.items():
            drive.transmission.advance(TICK_S)
            self._servo(name, drive)
        for step in range(TICK_SERVOS):
            if step:
                for name, drive in self._drives.items():
                    if not drive.idle:
                        self._servo(name, drive)
            self.world.step(SERVO_STEPS)
        self._times.append(self.world.time_s)
        for name, drive in self._drives.items():
            commanded = np.append(drive.q_cmd, drive.jaw_cmd)
            measured = np.append(drive.q_cmd, self.world.jaw_rad(name))
            self._rows[name].append((commanded, measured))
            self._finish(drive)

    def _servo(self, name: str, drive: _Drive) -> None:
        """Send the drives where the cables hold the joints after the next command."""
        if drive.path is not None:
            drive.q_cmd = next(drive.path, drive.q_cmd)
        step = drive.arm.jaw.max_speed * SERVO_S
        drive.jaw_cmd += min(max(drive.jaw_goal - drive.jaw_cmd, -step), step)
        target = drive.transmission.joints(drive.q_cmd)
        velocity = (target - drive.q_target) / (TICK_S if drive.idle else SERVO_S)
        drive.q_target = target
        self.world.drive_arm(name, target, velocity, drive.jaw_cmd)

    def _finish(self, drive: _Drive) -> None:
        if drive.path is not None:
            drive.ticks_left -= 1
            if drive.ticks_left == 0:
                drive.path = None
                drive.moved.set()
        if drive.jaw_cmd == drive.jaw_goal:
            drive.jaw_done.set()
