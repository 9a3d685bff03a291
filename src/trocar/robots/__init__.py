"""Robots: the driver that plays set-points back, and wrappers for any robot."""

from trocar.robots.adaptive import Adaptive
from trocar.robots.arm_script import ArmScript
from trocar.robots.compensated import Calibrated
from trocar.robots.driver import TICK_S, Driver
from trocar.robots.executor import TrajectoryExecutor
from trocar.robots.guarded import ArmGuard, Guarded, JointEstimator

__all__ = [
    "TICK_S",
    "Adaptive",
    "ArmGuard",
    "ArmScript",
    "Calibrated",
    "Driver",
    "Guarded",
    "JointEstimator",
    "TrajectoryExecutor",
]
