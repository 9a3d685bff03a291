"""Disturbances of a task over CRTK: of script, loop, robot, network and machine."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from served_record import WHERE, ServedRecord

from trocar.hardware.arm import Fault
from trocar.lab import load_station

HERE = Path(__file__).parent
STATION = "peg-transfer"
LIMITS = [arm.limits for arm in load_station(STATION).arms.values()]
VARIANT = "bilateral"
BUDGET_S = 7.0
"""The task's time budget: an undisturbed script is stopped after this."""
START_S, END_S = 60.0, 60.0
JUST_S = 0.05
"""This long before a planted fault begins, the bench checks whether something else has stopped the arms."""
LAST_S = 1.0
"""A fault this long before the script's end must be noticed, since another motion begins; a later one need not."""
PIDFD_GETFD, SO_ATTACH_FILTER = 438, 26
_RETURN = ctypes.create_string_buffer(struct.pack("HBBI", 0x06, 0, 0, 0))  # keep 0 bytes of a packet
_NOTHING = struct.pack("HL", 1, ctypes.addressof(_RETURN))
SHORT_S = 0.3
"""An interruption that is shorter need not be noticed."""


class Process:
    """A command in a process group of its own, whose output goes to a file."""

    def __init__(self, words: Sequence[object], log: Path, environment: dict[str, str], python: str = sys.executable):
        with log.open("a") as file:
            self._popen = subprocess.Popen(
                [python, "-m", "trocar", *map(str, words)],
                env={**os.environ, **environment, "PYTHONPATH": os.pathsep.join(sys.path)},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                process_group=0,  # not a new session, which might be scheduled apart from busy processes
            )
        self.pid, self.log = self._popen.pid, log

    @property
    def code(self) -> int | None:
        """Return its exit code; None while it runs."""
        return self._popen.poll()

    def ended(self, limit_s: float) -> bool:
        """Return whether it ends within some time."""
        return until(lambda: self.code is not None, limit_s)

    def family(self) -> dict[int, str]:
        """Return the command lines of the live processes of its group, by process id."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                stat = (folder / "stat").read_text().rpartition(")")[2].split()
                if int(stat[2]) == self.pid and stat[0] != "Z":
                    found[int(folder.name)] = (folder / "cmdline").read_text()
        return found

    def loop(self) -> int:
        """Return the process id of the arms' loop.

        Raises:
            ProcessLookupError: it has ended.
        """
        for pid, line in self.family().items():
            if "spawn_main" in line:
                return pid
        raise ProcessLookupError

    def stopped(self) -> bool:
        """Return whether its output reports a fault."""
        return ": fault: " in self.log.read_text()

    def clear(self, limit_s: float) -> list[str]:
        """Wait for the group to end; kill what is left, and return its command lines."""
        until(lambda: not self.family(), limit_s)
        left = self.family()
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.ended(5.0)
        return list(left.values())


def until(condition: Callable[[], object], limit_s: float) -> bool:
    """Wait up to ``limit_s`` for a condition; return whether it became true."""
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.02)
    return True


class Robot:
    """A served cell with a task on its table, in a process of its own, and what its arms did.

    Args:
        folder: for its files; it must not exist.
        plant: a fault of the first arm; empty: none.
        fault_s: time from the start to the fault.
        words: further arguments of its command.
        python: the interpreter that runs it.
    """

    def __init__(
        self,
        folder: Path,
        plant: str = "",
        fault_s: float = 0.0,
        words: Sequence[object] = (),
        python: str = sys.executable,
    ):
        folder.mkdir(parents=True)
        self.station, self.plant, self.fault_s = folder / "served/station.toml", plant, fault_s
        words = [*words, "--fault", f"psm1:{plant}@{fault_s:.2f}s"] if plant else words
        line = ["crtk", "serve", STATION, "--task", STATION, "--option", f"variant={VARIANT}", "--seed", 1]
        line += ["--images-hz", 0]
        line += ["--plugin", HERE / "served_record.py", "--out", folder / "served", *words]
        self.process = Process(line, folder / "log", {WHERE: str(folder / "record")}, python)
        self.record = ServedRecord(folder / "record", LIMITS)
        if not until(lambda: len(self.record) > 10 or self.process.code is not None, START_S) or self.process.code:
            raise RuntimeError(f"the served cell did not start: {self.process.log.read_text()}")
        self.began_s = time.monotonic()

    def stop(self) -> list[str]:
        """Kill it and wait for its group; return the command lines of what had to be killed then."""
        if self.process.code is None:
            os.kill(self.process.pid, signal.SIGKILL)  # its record is written, and its pictures take seconds
        return self.process.clear(10.0)


@dataclass(frozen=True)
class Scene:
    """A running task: the client's process, the robot, and the time at which its arms began to move."""

    client: Process
    robot: Robot
    rng: random.Random
    moved_s: float


@dataclass(frozen=True)
class Done:
    """A disturbance that happened: in words, how long it lasted, and whether the robot can be used again."""

    what: str
    lasted_s: float = math.inf
    robot_is_well: bool = True


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance.

    Attributes:
        happen: causes the disturbance.
        faults: the client has to name one of these if it lasts longer than ``SHORT_S``; empty: it need not notice.
        moving: whether it has to do so only if the arms were moving.
        plant: fault with which the robot is started; empty: none.
    """

    happen: Callable[[Scene], Done]
    faults: tuple[Fault, ...] = ()
    moving: bool = False
    plant: str = ""


def happen(kind: Kind, scene: Scene) -> Done:
    """Disturb a task; report that nothing happened if the process to disturb has just ended."""
    try:
        stopped = scene.client.stopped()
        done = kind.happen(scene)
        return replace(done, what=f"{done.what}, when it had stopped already", lasted_s=0.0) if stopped else done
    except (ProcessLookupError, FileNotFoundError):
        return Done("nothing: it had ended", 0.0)


def _kill(pid: int, who: str, *, robot_is_well: bool = True) -> Done:
    os.kill(pid, signal.SIGKILL)
    return Done(f"{who} killed", robot_is_well=robot_is_well)


def _pause(pid: int, who: str, seconds: float) -> Done:
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)
    return Done(f"{who} paused for {seconds:.2f} s", seconds)


def _seconds(rng: random.Random) -> float:
    """Return .05 to 3 s, uniform in the logarithm."""
    return 0.05 * 60 ** rng.random()


def drop_sockets(pid: int) -> int:
    """Cut off all network sockets of another process; return how many.

    TCP sockets are shut down, which both sides notice; UDP sockets lose whatever arrives, as on a cut network.
    """
    process, dropped = os.pidfd_open(pid), 0
    call = ctypes.CDLL(None, use_errno=True).syscall
    for entry in os.listdir(f"/proc/{pid}/fd"):
        with contextlib.suppress(OSError):
            if os.readlink(f"/proc/{pid}/fd/{entry}").startswith("socket:"):
                copy = call(PIDFD_GETFD, process, int(entry), 0)
                if copy < 0:
                    raise OSError(ctypes.get_errno(), "pidfd_getfd")
                with socket.socket(fileno=copy) as one:
                    if one.family == socket.AF_INET:
                        dropped += 1
                        if one.type == socket.SOCK_STREAM:
                            one.shutdown(socket.SHUT_RDWR)
                        else:
                            one.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, _NOTHING)
    os.close(process)
    return dropped


def _drop(pid: int, who: str, *, robot_is_well: bool = True) -> Done:
    return Done(f"{drop_sockets(pid)} sockets of {who} dropped", robot_is_well=robot_is_well)


def _starve(scene: Scene) -> Done:
    seconds, count = scene.rng.uniform(1.0, 5.0), scene.rng.randint(3, 8)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        until(lambda: scene.client.code is not None, seconds)
    finally:
        for one in busy:
            one.kill()
            one.wait()
    return Done(f"{count} busy processes for {seconds:.1f} s")


def _end(scene: Scene) -> Done:
    os.kill(scene.robot.process.pid, signal.SIGTERM)
    return Done("robot told to end", robot_is_well=False)


def _wait(scene: Scene) -> Done:
    """Wait for the fault that was planted in the robot when it was started."""
    due_s = scene.robot.began_s + scene.robot.fault_s
    until(lambda: scene.client.code is not None, max(0.0, due_s - JUST_S - time.monotonic()))
    moving = scene.client.code is None and not scene.client.stopped()
    until(lambda: scene.client.code is not None, JUST_S)
    noticed = moving and due_s < scene.moved_s + BUDGET_S - LAST_S
    return Done(f"{scene.robot.plant} from {due_s - scene.moved_s:.1f} s on", math.inf if noticed else 0.0, False)


SILENT = (Fault.LOST, Fault.STALE, Fault.FOLLOWING)
KINDS: dict[str, Kind] = {
    "script killed": Kind(lambda s: _kill(s.client.pid, "script")),
    "loop killed": Kind(lambda s: _kill(s.client.loop(), "loop"), (Fault.GONE,)),
    "robot killed": Kind(lambda s: _kill(s.robot.process.pid, "robot", robot_is_well=False), SILENT),
    "robot told to end": Kind(_end, SILENT),
    "robot paused": Kind(lambda s: _pause(s.robot.process.pid, "robot", _seconds(s.rng)), SILENT),
    "script paused": Kind(lambda s: _pause(s.client.pid, "script", _seconds(s.rng))),
    "loop paused": Kind(lambda s: _pause(s.client.loop(), "loop", _seconds(s.rng)), (Fault.LATE, *SILENT), moving=True),
    "script's sockets": Kind(lambda s: _drop(s.client.pid, "script")),
    "loop's sockets": Kind(lambda s: _drop(s.client.loop(), "loop"), SILENT),
    "robot's sockets": Kind(lambda s: _drop(s.robot.process.pid, "robot", robot_is_well=False), SILENT, moving=True),
    "stream ends": Kind(_wait, SILENT, plant="silent"),
    "stream freezes": Kind(_wait, (Fault.STALE, Fault.FOLLOWING), plant="stale"),
    "encoders freeze": Kind(_wait, (Fault.FOLLOWING,), plant="frozen"),
    "encoders read NaN": Kind(_wait, (Fault.INVALID,), plant="nan"),
    "controller pauses": Kind(_wait, (Fault.PAUSED,), plant="paused"),
    "controller in fault": Kind(_wait, (Fault.CONTROLLER,), plant="fault"),
    "machine busy": Kind(_starve),
}
