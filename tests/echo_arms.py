"""Stand-ins for real arms, as their loop sees them: they follow their set-points, or have a fault."""

from __future__ import annotations

import sys
import time
from collections import deque
from functools import partial

import numpy as np

from driven import HOME, PAPER
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import HardwareReading, LoopSettings
from trocar.lab import load_station
from trocar.motion import rest_to_rest


class EchoArm:
    """An arm whose encoders read its last set-point; ``log`` is a file to which set-points are appended."""

    def __init__(self, log=None):
        self.q, self.jaw, self.log = HOME.copy(), 0.1, log

    def commanded(self):
        return self.q, self.jaw

    def read(self):
        return HardwareReading(self.q, self.jaw)

    def send(self, q, velocity, jaw_rad):
        self.q, self.jaw = q.copy(), jaw_rad
        if self.log is not None:
            with open(self.log, "a") as file:
                print(time.monotonic(), *q, *velocity, jaw_rad, file=file)

    def close(self):
        pass


class DelayedJaws(EchoArm):
    """An arm whose jaws read their set-point of some ticks ago, as over a network."""

    TICKS = 8

    def __init__(self):
        super().__init__()
        self.sent = deque([self.jaw] * (self.TICKS + 1), maxlen=self.TICKS + 1)

    def read(self):
        self.sent.append(self.jaw)
        return HardwareReading(self.q, self.sent[0])


def with_delayed_jaws(name):
    return DelayedJaws()


class Stuck(EchoArm):
    """An arm that hangs in ``read`` after so many readings, of which connecting takes the first."""

    def __init__(self, reads):
        super().__init__()
        self.reads = reads

    def read(self):
        self.reads -= 1
        if self.reads < 0:
            time.sleep(600.0)
        return super().read()


def stuck(name):
    return Stuck(30)


def stuck_at_once(name):
    """Return an arm that hangs in the loop's first tick."""
    return Stuck(1)


def connect(name, log=None):
    return EchoArm(log if name == "psm1" else None)


def refusing(name):
    raise OSError(f"no such arm: {name}")


FAR = HOME + np.array([0.6, 0.4, -0.04, 1.5, 1.0, -1.0])


def main(log):
    """Move an arm for some seconds; a test kills or freezes this process meanwhile."""
    settings = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=0.5)

    async def script(cell):
        slow = rest_to_rest(HOME, FAR, PAPER).stretched(4.0)
        await cell.robot.move({"psm1": slow})

    with HardwareLaboratory(load_station("peg-transfer"), partial(connect, log=log), settings) as laboratory:
        laboratory.run(script, 30.0)


if __name__ == "__main__":
    main(sys.argv[1])
