"""The hardware loop at 100, 200 and 500 Hz, with arms that only echo their set-points: jitter, and use of the limits.

A script moves both arms back and forth while it computes in Python; then processes are killed, frozen or interrupted
at random times. Times depend on the machine.

    python benchmarks/bench_hardware_loop.py                  # 20 s a rate, 20 stops
    python benchmarks/bench_hardware_loop.py --seconds 600 --stops 200
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import random
import signal
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trio

from trocar.arms import MotionLimits
from trocar.cell import Cell
from trocar.errors import TrocarError
from trocar.hardware import HardwareLaboratory, HardwareReading, LoopSettings
from trocar.lab import load_station
from trocar.motion import rest_to_rest

STATION = load_station("peg-transfer")
ARMS = tuple(STATION.arms)
LIMITS = STATION.arms[ARMS[0]].limits
SLOW = MotionLimits(LIMITS.velocity / 4, LIMITS.acceleration / 4)
SWING = np.array([0.3, 0.2, -0.03, 0.8, 0.4, -0.4])


class EchoArm:
    """An arm whose encoders read its set-points, which it writes to a file with their times."""

    def __init__(self, name: str, folder: Path):
        self.q, self.jaw_rad = STATION.arms[name].park_q(), 0.1
        self.file = (folder / name).open("ab", buffering=0)

    def commanded(self):
        """Return the present joints and opening."""
        return self.q, self.jaw_rad

    def read(self):
        """Return the last set-point."""
        return HardwareReading(self.q, self.jaw_rad)

    def send(self, q, velocity, jaw_rad):
        """Take a set-point and write it to the file."""
        self.q, self.jaw_rad = q, jaw_rad
        self.file.write(np.array([time.monotonic(), *q, *velocity]).tobytes())

    def close(self):
        """Close the file."""
        self.file.close()


def sent(folder: Path, arm: str) -> np.ndarray:
    """Return what an arm was sent: time, joints, velocities (n, 13)."""
    data = (folder / arm).read_bytes() if (folder / arm).is_file() else b""
    return np.frombuffer(data[: len(data) // 104 * 104]).reshape(-1, 13)


@dataclass
class Use:
    """Largest velocity and acceleration of an arm's set-points, tick by tick, as shares of the limits."""

    velocity: float
    acceleration: float


def use(rows: np.ndarray, tick_s: float) -> Use:
    """Return the largest shares of velocity and acceleration limits."""
    if len(rows) < 3:
        return Use(0.0, 0.0)
    velocity, acceleration = np.diff(rows[:, 1:7], axis=0) / tick_s, np.diff(rows[:, 1:7], 2, axis=0) / tick_s**2
    return Use(np.abs(velocity / LIMITS.velocity).max(), np.abs(acceleration / LIMITS.acceleration).max())


async def swing(cell: Cell, until_s: float) -> None:
    """Move all arms back and forth, computing in Python half of the time."""
    homes = {name: cell.robot.setpoint(name).q.copy() for name in cell.arms}

    async def compute() -> None:
        while True:
            end_s = time.monotonic() + 0.05
            while time.monotonic() < end_s:
                sum(range(1000))
            await trio.sleep(0.05)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(compute)
        away = False
        while cell.clock.now_s() < until_s:
            away = not away
            goals = {name: home + SWING * away for name, home in homes.items()}
            motions = {name: rest_to_rest(cell.robot.setpoint(name).q, goal, SLOW) for name, goal in goals.items()}
            await cell.robot.move(motions)
        nursery.cancel_scope.cancel()


def steady(rate_hz: int, seconds: float) -> None:
    """Run the loop for some time; print its jitter and use of the limits."""
    with tempfile.TemporaryDirectory() as name:
        folder, tick_s = Path(name), 1.0 / rate_hz
        settings = LoopSettings(tick_s=tick_s, max_late=10**9, max_stall_s=10.0)
        with HardwareLaboratory(STATION, partial(EchoArm, folder=folder), settings) as laboratory:
            laboratory.run(lambda cell: swing(cell, seconds), seconds + 30.0)
        rows = sent(folder, ARMS[0])
        steps_s = np.diff(rows[:, 0])
        late = np.mean(steps_s > 1.5 * tick_s)
        worst = max((use(sent(folder, arm), tick_s) for arm in ARMS), key=lambda u: u.acceleration)
        print(
            f"{rate_hz} Hz, {seconds:g} s: a tick takes {1e3 * np.median(steps_s):.3f} ms (p50), "
            f"{1e3 * np.percentile(steps_s, 99.9):.3f} (p99.9), {1e3 * steps_s.max():.1f} (max); {late:.2%} late; "
            f"largest share of velocity limits {worst.velocity:.3f}, of acceleration limits {worst.acceleration:.3f}"
        )


def victim(folder: Path) -> None:
    """Move the arms until killed; runs in the process that is stopped."""
    settings = LoopSettings(max_late=10**9, max_stall_s=10.0)
    connect = partial(EchoArm, folder=folder)
    with (
        contextlib.suppress(KeyboardInterrupt, TrocarError),
        HardwareLaboratory(STATION, connect, settings) as laboratory,
    ):
        laboratory.run(lambda cell: swing(cell, 60.0), 90.0)


def stopped(rng: random.Random) -> tuple[str, bool, Use]:
    """Stop a process at a random time; return how, whether the arms came to rest, and their use of the limits."""
    how = rng.choice(["script killed", "script frozen", "loop told to end", "script interrupted"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = multiprocessing.get_context("spawn").Process(target=victim, args=(folder,))
        process.start()
        while len(sent(folder, ARMS[0])) < 10:
            time.sleep(0.05)
        time.sleep(rng.uniform(0.1, 1.5))
        loop = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()[-1])
        target, with_signal = {
            "script killed": (process.pid, signal.SIGKILL),
            "script frozen": (process.pid, signal.SIGSTOP),
            "loop told to end": (loop, signal.SIGTERM),
            "script interrupted": (process.pid, signal.SIGINT),
        }[how]
        os.kill(target or 0, with_signal)
        time.sleep(3.0)
        process.kill()
        process.join()
        rows = [sent(folder, arm) for arm in ARMS]
        at_rest = all(len(row) > 0 and not row[-1, 7:].any() for row in rows)
        return how, at_rest, max((use(row, 0.01) for row in rows), key=lambda u: u.acceleration)


def main() -> None:
    """Measure each rate, then the stops."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--stops", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for rate_hz in (100, 200, 500):
        steady(rate_hz, given.seconds)
    rng, found = random.Random(given.seed), []
    for count in range(given.stops):
        found.append(stopped(rng))
        how, at_rest, worst = found[-1]
        if not at_rest or worst.acceleration > 1.001:
            print(f"stop {count}: {how}: at rest {at_rest}, {worst}")
    rest, worst = sum(at_rest for _, at_rest, _ in found), max((w.acceleration for *_, w in found), default=0.0)
    print(f"{rest} of {len(found)} stops came to rest; largest share of acceleration limits {worst:.3f}")


if __name__ == "__main__":
    main()
