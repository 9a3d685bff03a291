"""Tasks: one folder each. They are registered by entry points (``pyproject.toml``)."""

from trocar.registry import Registry
from trocar.tasks.kit import Task

TASKS: Registry[type[Task]] = Registry("task", "trocar.tasks")
"""Every task by its name on the command line."""

__all__ = ["TASKS", "Task"]
