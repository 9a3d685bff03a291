"""Robots: the driver that executes trajectories, and wrappers for any robot."""

from trocar.robots.adaptive import Adaptive
from trocar.robots.arm_script import ArmScript
from trocar.robots.compensated import Compensated
from trocar.robots.coordinator import Blocked, Coordinator, Margins
from trocar.robots.driver import TICK_S, Driver
from trocar.robots.executor import TrajectoryExecutor
from trocar.robots.guarded import ArmGuard, Guarded, JointEstimator
from trocar.robots.traffic import Departure

__all__ = [
    "TICK_S",
    "Adaptive",
    "ArmGuard",
    "ArmScript",
    "Blocked",
    "Compensated",
    "Coordinator",
    "Departure",
    "Driver",
    "Guarded",
    "JointEstimator",
    "Margins",
    "TrajectoryExecutor",
]
