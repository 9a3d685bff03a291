"""Robots: the driver that plays set-points back, and wrappers for any robot."""

from trocar.robots.adaptive import Adaptive
from trocar.robots.calibrated import Calibrated
from trocar.robots.driver import TICK_S, Driver
from trocar.robots.guarded import ArmGuard, Belief, Guarded
from trocar.robots.playback import Playback

__all__ = ["TICK_S", "Adaptive", "ArmGuard", "Belief", "Calibrated", "Driver", "Guarded", "Playback"]
