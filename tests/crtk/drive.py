"""Drive one arm of a dialect: it keeps the promises of a robot, and a motion ends where it was sent.

Arguments: station, arm, JSON of what ``Topics`` takes. It prints joints and opening to which it has sent the arm.
"""

import json
import sys
import time
from dataclasses import replace
from functools import partial

import numpy as np

from trocar.arms import MotionLimits
from trocar.crtk.arm import CrtkArm
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import LoopSettings
from trocar.lab import load_station
from trocar.lab.topics import Command, Dialect, Topics
from trocar.motion import rest_to_rest
from trocar.testing import check_robot

PATIENT = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0, stale_s=5.0, lag_s=1.0)
"""A machine that runs other tests beside this one may be late."""
JAW_RAD_S = 0.45
KEPT = MotionLimits(np.array([0.24, 0.24, 0.0048, 0.24, 0.24, 0.24]), np.array([1.0, 1.0, 0.03, 1.0, 1.0, 1.0]))
"""What a Raven can keep at 100 Hz; and its jaws, each of which has .25 rad/s."""
HURRIED = MotionLimits(1.25 * KEPT.velocity, KEPT.acceleration)
"""What it cannot: it comes a little later."""
SPAN, NEAR, LIMIT_S = 0.02, 1e-6, 20.0


def drive(station_name, name, given):
    loop = {"stale_s": PATIENT.stale_s}
    kinds = {"dialect": Dialect(given["dialect"]), "command": Command(given["command"])}
    topics = Topics(**given | kinds | {"loop": loop})
    station = load_station(station_name)
    arm = station.arms[name]
    arm = replace(arm, model=replace(arm.model, jaw=replace(arm.model.jaw, max_speed=JAW_RAD_S)))
    station = replace(station, arms={name: arm})
    sent, jaw_near = [], 0.1 if topics.dialect is Dialect.DVRK else NEAR  # our own server's have a cable that errs

    async def script(cell):
        await check_robot(cell, name, span=SPAN, limits=KEPT)
        home = cell.robot.setpoint(name).q
        towards = np.where(home > arm.model.middle, -1.0, 1.0)
        goal = home + SPAN / 2 * towards * (arm.model.upper - arm.model.lower)
        result = (await cell.robot.move({name: rest_to_rest(home, goal, HURRIED)}))[name]
        assert result.done, result.reason
        opened = await cell.robot.jaw(name, 0.5)
        assert opened.done, opened.reason
        end_s = time.monotonic() + LIMIT_S
        while (
            np.abs(cell.robot.read(name).q - goal).max() > NEAR or abs(cell.robot.read(name).jaw_rad - 0.5) > jaw_near
        ):
            assert time.monotonic() < end_s, f"it is at {cell.robot.read(name)}, not at {goal}"
            await cell.clock.sleep(0.01)
        sent.extend([*goal, 0.5])

    with HardwareLaboratory(station, partial(CrtkArm, topics=topics), PATIENT) as laboratory:
        assert laboratory.run(script, 120.0)
        assert max(laboratory.robot.limit_use(name)) <= 1.001
    print(json.dumps(sent))


if __name__ == "__main__":
    drive(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
