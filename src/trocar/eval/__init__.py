"""Evaluation: what a task and a method are; how runs of them are configured, played, saved and loaded.

This module exports what a task's own code needs. Runs (``trocar.eval.run``) need the simulator.
"""

from trocar.eval.method import (
    METHODS,
    PERCEPTIONS,
    Agent,
    AgentContext,
    Method,
    methods_of,
    perceptions_of,
    pick_method,
    pick_perception,
)
from trocar.eval.task import TASKS, Score, Task, check_budget, check_task, option, stopped, told
from trocar.eval.task_report import PaperCount, PaperRow, TaskReport, in_words

__all__ = [
    "METHODS",
    "PERCEPTIONS",
    "TASKS",
    "Agent",
    "AgentContext",
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
