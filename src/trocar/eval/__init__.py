"""Evaluation: define tasks and methods; configure, play, save and load runs of them.

This module exports what a task's own code needs. Runs (``trocar.eval.run``) need the simulator.
"""

from trocar.eval.method import (
    METHODS,
    PERCEPTIONS,
    Agent,
    AgentContext,
    Method,
    listed_settings,
    methods_of,
    methods_of_any,
    perceptions_of,
    pick_method,
    pick_perception,
)
from trocar.eval.task import TASKS, Score, Task, agent_explanation, check_budget, option, stopped
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
    "agent_explanation",
    "check_budget",
    "in_words",
    "listed_settings",
    "methods_of",
    "methods_of_any",
    "option",
    "perceptions_of",
    "pick_method",
    "pick_perception",
    "stopped",
]
