"""The parts of a task, and helpers for its scripts."""

from trocar.tasks.kit.arm_script import ArmScript
from trocar.tasks.kit.method import (
    METHODS,
    PERCEPTIONS,
    Agent,
    Brief,
    Method,
    methods_of,
    perceptions_of,
    pick_method,
    pick_perception,
)
from trocar.tasks.kit.task import Score, Task, check_budget, check_task, option, stopped, told
from trocar.tasks.kit.task_report import PaperCount, PaperRow, TaskReport, in_words

__all__ = [
    "METHODS",
    "PERCEPTIONS",
    "Agent",
    "ArmScript",
    "Brief",
    "Method",
    "PaperCount",
    "PaperRow",
    "Score",
    "Task",
    "TaskReport",
    "check_budget",
    "check_task",
    "in_words",
    "methods_of",
    "option",
    "perceptions_of",
    "pick_method",
    "pick_perception",
    "stopped",
    "told",
]
