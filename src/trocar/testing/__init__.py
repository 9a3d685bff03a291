"""Checks that every task, robot, cable model and planner must pass, yours as well as those of the package."""

from trocar.testing.cable_model import check_cable_model
from trocar.testing.hardware import check_hardware
from trocar.testing.planner import check_planner
from trocar.testing.requirement import CheckFailed
from trocar.testing.robot import check_robot
from trocar.testing.task import check_task

__all__ = ["CheckFailed", "check_cable_model", "check_hardware", "check_planner", "check_robot", "check_task"]
