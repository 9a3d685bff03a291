"""Simulated arms: a driver whose set-points move the joints of the physics through the transmissions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trocar.cell import JointReading
from trocar.geometry.arrays import Array
from trocar.lab import StationArm
from trocar.lab.transmission import DriveTrain, JawCable
from trocar.robots.driver import TICK_S, Driver
from trocar.sim.spec import TIMESTEP_S
from trocar.sim.world import World

SERVO_STEPS = 2
"""Physics steps between two updates of the servos' targets."""
SERVO_S = SERVO_STEPS * TIMESTEP_S
TICK_SERVOS = round(TICK_S / SERVO_S)


class SimRobot(Driver):
    """Arms in the simulated world. Encoders are on the motors' side of the transmissions."""

    def __init__(self, world: World, now_s: Callable[[], float]):
        super().__init__(now_s)
        self._world = world
        self._trains: dict[str, DriveTrain] = {}
        self._pulled: dict[str, Array] = {}
        self._jaws: dict[str, tuple[JawCable, float]] = {}
        self._silent: set[str] = set()

    def attach_train(self, name: str, arm: StationArm, train: DriveTrain, cable: JawCable) -> None:
        """Park an arm of a station; from now on, this transmission and this cable of its jaws move it."""
        q_cmd, jaw_rad = arm.park_q(), arm.park_jaw_rad
        q_joint = train.joints(q_cmd)
        self._world.place_arm(name, q_joint, jaw_rad + cable.offset_rad)
        self.attach(name, arm.model, arm.limits, q_cmd, jaw_rad)
        self._trains[name], self._pulled[name], self._jaws[name] = train, q_joint, (cable, jaw_rad)

    def silence(self, name: str, silent: bool = True) -> None:
        """Stop an arm's readings, as a lost connection would; the arm still follows its set-points."""
        (self._silent.add if silent else self._silent.discard)(name)

    def tick(self, start_s: float) -> None:
        """Advance the physics by one period of the controller, starting at this time of the clock."""
        times = start_s + SERVO_S * np.arange(1.0, TICK_SERVOS + 1.0)
        sent = {name: (*self.targets(name, times), self.idle(name)) for name in self.names}
        for name in self.names:
            self._trains[name].advance(TICK_S)
        for step in range(TICK_SERVOS):
            for name, (q, _, jaw, idle) in sent.items():
                if step == 0 or not idle:
                    self._pull(name, q[step], float(jaw[step]), TICK_S if idle else SERVO_S)
            self._world.step(SERVO_STEPS)
        now, readings = float(times[-1]), {}
        for name in self.names:
            if name not in self._silent:
                q, _, jaw, _ = sent[name]
                jaw_rad = self._jaws[name][0].read(self._world.jaw_rad(name), float(jaw[-1]))
                readings[name] = JointReading(now, q[-1].copy(), jaw_rad)
        self.note(now, readings)

    def _pull(self, name: str, q_cmd: Array, jaw_rad: float, over_s: float) -> None:
        """Set the servos' targets to the joints at which the transmission holds the arm after this command."""
        target = self._trains[name].joints(q_cmd)
        velocity = (target - self._pulled[name]) / over_s
        self._pulled[name] = target
        cable, followed = self._jaws[name]
        pulled_rad, followed = cable.step(followed, jaw_rad)
        self._jaws[name] = cable, followed
        self._world.drive_arm(name, target, velocity, pulled_rad)
