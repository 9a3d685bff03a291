"""Arms without physics, whose joints follow through cables, and helpers that move them."""

import numpy as np
import trio

from driven import HOME, PAPER, PlainArms
from trocar.calibration.plant import PLANTS
from trocar.log import CellLog
from trocar.motion import rest_to_rest

PLANT = PLANTS["psm1_grey"]
GOALS = np.array(
    [
        [0.80, 0.10, 0.19, 0.40, 0.30, 0.30],
        [0.90, -0.10, 0.17, -0.90, -0.50, -0.60],
        [0.75, 0.05, 0.20, -0.20, 0.40, -0.90],
        [0.85, 0.00, 0.18, -0.30, -0.10, 0.20],
    ]
)


class CableArms(PlainArms):
    """Arms whose joints follow the set-points through a cable plant.

    Attributes:
        joints: for each arm, its true joints (6,) after every set-point.
        log: log for a wrapper of the robot.
    """

    def __init__(self, names=("a",), slack=(0.0, 0.0, 0.0)):
        super().__init__(names)
        self.state = {name: tuple(np.array(PLANT.start(HOME)) + slack) for name in names}
        self.joints = {name: [PLANT.step(self.state[name], HOME)[0]] for name in names}
        self.log = CellLog(self.now_s)
        self.each_tick.append(self._follow)

    def _follow(self):
        for name, rows in self.sent.items():
            for q in rows[len(self.joints[name]) :]:
                joints, self.state[name] = PLANT.step(self.state[name], q)
                self.joints[name].append(joints)

    async def sleep(self, seconds):
        await trio.sleep(seconds)

    async def compute(self, function, budget_s):
        result = function()
        await trio.sleep(budget_s)
        return result, 0.01


def to(arms, goal, name="a"):
    return {name: rest_to_rest(arms.robot.setpoint(name).q, goal, PAPER)}
