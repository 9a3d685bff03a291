"""Autonomous surgical sub-tasks on cable-driven robots: see, calibrate, plan, act, score."""

from importlib.metadata import version

__version__ = version("trocar")
